"""How sessions and streams end, in tests that look inside the server or stop it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import replace

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.messages import span
from motiongen_compliance.target import Target, connect
from motiongen_server.rpc.limits import Limits
from tests.channels import ALONE
from tests.contract.local import NO_BUDGET, LocalServer


@pytest.fixture
async def forgetful_server() -> AsyncIterator[LocalServer]:
    """A server that keeps no session whose transport is lost."""
    async with LocalServer(Limits(resume_grace_s=0)) as server:
        yield server


@pytest.fixture
async def forgetful(forgetful_server: LocalServer) -> AsyncIterator[Target]:
    async for target in connect(forgetful_server.address):
        yield target


@pytest.mark.parametrize("vanish", ["cancel", "connection"])
async def test_vanished_client_leaves_no_session_or_stream(
    forgetful_server: LocalServer, forgetful: Target, vanish: str
) -> None:
    local_server, local = forgetful_server, forgetful
    other = await local.talk()
    await other.open(1)
    channel = grpc.aio.insecure_channel(local_server.address, options=ALONE)
    async with channel:
        target = Target(type(local.stub)(channel), local.catalog)
        gone = await target.talk()
        for handle in range(5):
            await gone.open(handle)
        assert local_server.engine.num_sessions == 6
        if vanish == "cancel":
            gone.call.cancel()
        else:
            await channel.close()
        number = 0
        while local_server.engine.num_sessions > 1 or local_server.service.num_streams > 1:
            number += 1
            await other.ping(number)
    await other.plays_on(1)


async def test_client_that_vanishes_while_its_prompt_is_encoded_leaves_nothing(
    forgetful_server: LocalServer, forgetful: Target
) -> None:
    local_server, local = forgetful_server, forgetful
    other = await local.talk()
    gone = await local.talk()
    await gone.ask_open(1, prompts=[span("a text to be encoded")])
    gone.call.cancel()
    number = 0
    while local_server.service.num_streams > 1 or local_server.engine.num_sessions:
        number += 1
        await other.ping(number)
    await other.open(1)


async def test_draining_sends_goodbye_once_and_sessions_play_until_closed(
    local_server: LocalServer, local: Target
) -> None:
    talk = await local.talk()
    await talk.open(1)
    local_server.service.goodbye(2.5)
    await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
    goodbye = talk.responses[-1].goodbye
    assert goodbye.reason == service_pb2.GOODBYE_REASON_DRAINING
    assert goodbye.grace.ToMilliseconds() == 2500
    await talk.plays_on(1)
    await talk.ask_open(2)
    refused = await talk.answer(2, 1)
    assert (refused.code, refused.reason) == (grpc.StatusCode.UNAVAILABLE.value[0], "DRAINING")
    assert (refused.field, "another server" in refused.allowed) == ("open", True)
    local_server.service.close_all()
    assert await talk.to_the_end() is grpc.StatusCode.OK
    closed = talk.sessions[1].closed
    assert closed is not None
    assert closed.reason == session_pb2.CLOSE_REASON_DRAINED
    assert sum(response.HasField("goodbye") for response in talk.responses) == 1
    await local_server.service.finished()
    assert local_server.engine.num_sessions == 0


async def test_goodbye_is_not_repeated_when_a_draining_server_loses_its_engines(
    local_server: LocalServer, local: Target
) -> None:
    talk = await local.talk()
    await talk.open(1)
    local_server.service.goodbye(60.0)
    await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
    local_server.service.send_away()
    assert await talk.to_the_end() is grpc.StatusCode.OK
    assert sum(response.HasField("goodbye") for response in talk.responses) == 1


async def test_stream_that_begins_during_draining_gets_a_goodbye(local_server: LocalServer, local: Target) -> None:
    local_server.service.goodbye(60.0)
    talk = await local.talk()
    await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
    assert 0 < talk.responses[-1].goodbye.grace.ToMilliseconds() <= 60_000
    await talk.ask_open(1)
    assert (await talk.answer(1, 1)).reason == "DRAINING"


@pytest.fixture
async def restarting() -> AsyncIterator[LocalServer]:
    """A server with a setting for how long a restart takes."""
    async with LocalServer(Limits(), service_limits=replace(NO_BUDGET, reconnect_after_s=7.5)) as server:
        yield server


@pytest.fixture
async def before_restart(restarting: LocalServer) -> AsyncIterator[Target]:
    async for target in connect(restarting.address):
        yield target


async def test_goodbye_tells_when_to_reconnect(restarting: LocalServer, before_restart: Target) -> None:
    talk = await before_restart.talk()
    restarting.service.goodbye(60.0)
    await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
    assert talk.responses[-1].goodbye.reconnect_after.ToMilliseconds() == 7500


async def test_session_whose_generation_fails_ends_alone(local_server: LocalServer, local: Target) -> None:
    talk = await local.talk()
    await talk.open(2)
    local_server.runner.poisoned = lambda job: job.session.handle == 1
    heard = await talk.ask_open(1)
    await talk.until(lambda: heard.closed is not None)
    assert heard.closed is not None
    assert (heard.closed.reason, heard.closed.code) == (
        session_pb2.CLOSE_REASON_ENGINE_FAULT,
        grpc.StatusCode.INTERNAL.value[0],
    )
    assert heard.closed.message
    await talk.plays_on(2)
