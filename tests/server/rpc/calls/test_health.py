"""Health checks: watchers are told of every change, and one that does not read holds up no others."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Coroutine
from contextlib import asynccontextmanager

import grpc
import grpc.aio
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from motiongen_server.rpc.calls import health
from motiongen_server.rpc.calls.bounded_write import write_within
from motiongen_server.rpc.calls.context import streaming_method
from motiongen_server.rpc.calls.health import Health, add_health
from motiongen_server.rpc.calls.requests import Requests
from tests.waiting import LIMIT_S, try_again

SERVING, NOT_SERVING = health_pb2.HealthCheckResponse.SERVING, health_pb2.HealthCheckResponse.NOT_SERVING
WHOLE = health_pb2.HealthCheckRequest()


@asynccontextmanager
async def served(checks: Health) -> AsyncIterator[health_pb2_grpc.HealthStub]:
    server = grpc.aio.server()
    add_health(checks, server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    async with asyncio.timeout(LIMIT_S), grpc.aio.insecure_channel(f"127.0.0.1:{port}") as channel:
        yield health_pb2_grpc.HealthStub(channel)
    await server.stop(None)


async def test_watchers_are_told_of_changes_and_checks_are_answered() -> None:
    checks = Health()
    checks.set("", NOT_SERVING)
    async with served(checks) as stub:
        watch = stub.Watch(WHOLE)
        assert (await watch.read()).status == NOT_SERVING
        checks.set("", SERVING)
        assert (await watch.read()).status == SERVING
        assert (await stub.Check(WHOLE)).status == SERVING
        with pytest.raises(grpc.aio.AioRpcError, match="no service 'other' is served here") as missing:
            await stub.Check(health_pb2.HealthCheckRequest(service="other"))
        assert missing.value.code() is grpc.StatusCode.NOT_FOUND


async def test_watches_of_an_address_are_limited_and_ended_ones_free_their_place(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(health, "MOST_OF_AN_ADDRESS", 2)
    checks = Health()
    checks.set("", SERVING)
    async with served(checks) as stub:
        first, second = stub.Watch(WHOLE), stub.Watch(WHOLE)
        for watch in (first, second):
            await watch.read()
        third = stub.Watch(WHOLE)
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await third.read()
        assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert (await stub.Check(WHOLE)).status == SERVING, "a check needs no place"
        first.cancel()
        while True:
            again = stub.Watch(WHOLE)
            try:
                await again.read()
                break
            except grpc.aio.AioRpcError:
                await try_again()  # the server does not know yet that the first has ended


class Stuck:
    """The context of a watcher that takes nothing for a while."""

    def __init__(self) -> None:
        self.is_writing = asyncio.Event()
        self.takes = asyncio.Event()
        self.has_taken = False
        self.had_taken = False  # when its call was ended
        self.code: grpc.StatusCode | None = None
        self._sends = iter((WHOLE.SerializeToString(), grpc.aio.EOF))

    async def read(self) -> object:
        return next(self._sends)

    def peer(self) -> str:
        return "ipv4:10.0.0.7:1"

    async def write(self, _message: object) -> None:
        self.is_writing.set()
        await self.takes.wait()
        self.has_taken = True

    async def abort(self, code: grpc.StatusCode, *_: object) -> None:
        self.had_taken = self.has_taken
        self.code = code


class Late(Stuck):
    """A watcher that takes what is written to it some time after the write has begun."""

    async def write(self, message: object) -> None:
        # Begins after the wait that it outlasts, however late that begins.
        asyncio.get_running_loop().call_later(2 * health.STUCK_S, self.takes.set)
        await super().write(message)


async def watched(checks: Health, watcher: Stuck) -> None:
    """Serves a watch as gRPC does, from its beginning to its end."""
    await streaming_method(checks.Watch, Requests()).stream_stream(None, watcher)


async def test_watcher_that_takes_nothing_holds_up_no_check_and_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    given_up = asyncio.Event()

    async def within(limit_s: float, write: Coroutine[None, None, None]) -> None:
        try:
            await write_within(limit_s, write)
        finally:
            given_up.set()

    monkeypatch.setattr(health, "STUCK_S", 0.05)
    monkeypatch.setattr(health, "write_within", within)
    checks, stuck = Health(), Stuck()
    watching = asyncio.create_task(watched(checks, stuck))
    await stuck.is_writing.wait()
    checks.set("", SERVING)
    async with served(checks) as stub:
        assert (await stub.Check(WHOLE)).status == SERVING
    await given_up.wait()
    assert not watching.done(), "gRPC still holds the call, so it has to be counted"
    stuck.takes.set()
    await watching
    assert stuck.code is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_watcher_that_takes_its_first_status_late_gets_the_reason_after_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """gRPC sends no status for a call whose first response is still being written."""
    monkeypatch.setattr(health, "STUCK_S", 0.05)
    late = Late()
    await watched(Health(), late)
    assert late.code is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert late.had_taken
