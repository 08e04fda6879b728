"""Sessions that are kept while their client is away, seen from inside the server."""

from __future__ import annotations

import asyncio

import pytest

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import waypoint
from motiongen_compliance.target import Target, connect
from motiongen_server.engine.config import EngineConfig
from motiongen_server.rpc.limits import Limits
from tests.contract.local import LocalServer


async def test_resume_of_a_session_that_ended_meanwhile_tells_its_end(local_server: LocalServer, local: Target) -> None:
    first, second = await local.talk(), await local.talk()
    heard = await first.open(1)
    first.call.cancel()
    while local_server.service.num_parked < 1:
        await second.ping(1)
    local_server.service.close_model(local_server.model)
    while local_server.engine.num_sessions:
        await second.ping(1)
    await second.ask_resume(1, heard)
    await second.until(lambda: heard.closed is not None or heard.outcomes)
    assert heard.closed is not None
    assert heard.closed.reason == session_pb2.CLOSE_REASON_MODEL_UNLOADED
    await second.open(1)


async def test_kept_sessions_count_towards_the_limit_and_close_after_the_grace(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    grace_s, leapt_s = 3600.0, [0.0]  # the test moves the clock
    loop_time = asyncio.get_running_loop().time
    monkeypatch.setattr(asyncio.get_running_loop(), "time", lambda: loop_time() + leapt_s[0])
    async with LocalServer(Limits(resume_grace_s=grace_s), EngineConfig(max_sessions=2)) as server:
        async for target in connect(server.address):
            first, other = await target.talk(), await target.talk()
            heard = await first.open(1, constraints=[waypoint(60, x=1)])
            await other.open(1)
            first.call.cancel()
            number = 0
            while server.service.num_parked < 1:
                number += 1
                await other.ping(number)
            await other.ask_open(2)
            assert (await other.answer(2, 1)).reason == "SESSION_LIMIT"
            assert (server.service.num_parked, server.engine.num_sessions) == (1, 2)
            leapt_s[0] = grace_s
            while server.engine.num_sessions > 1:
                number += 1
                await other.ping(number)
            assert server.service.num_parked == 0
            second = await target.talk()
            await second.ask_resume(1, heard)
            assert (await second.answer(1, 1)).reason == "SESSION_NOT_KEPT"
            await other.plays_on(1)


async def test_server_with_a_grace_of_0_keeps_no_session() -> None:
    async with LocalServer(Limits(resume_grace_s=0)) as server:
        async for target in connect(server.address):
            assert not target.catalog.limits.resume_grace.ToMilliseconds()
            first, other = await target.talk(), await target.talk()
            heard = await first.open(1)
            assert heard.opened is not None
            assert heard.opened.session_token == ""
            first.call.cancel()
            number = 0
            while server.engine.num_sessions:
                number += 1
                await other.ping(number)
