"""Clients that do not read, or send nothing, over gRPC: what becomes of their sessions, and that others play on."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager

import grpc.aio
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from motiongen_server.engine.config import EngineConfig
from motiongen_server.rpc.limits import Limits
from tests.contract.local import NO_BUDGET, UNMETERED, LocalServer
from tests.waiting import LIMIT_S, until_true

KIB = 1 << 10
NOTHING = service_pb2.StreamMotionRequest(events=[session_pb2.SessionEvent(session=5)] * 20_000)
"""Each of these events costs the server an answer of some hundred bytes."""


@asynccontextmanager
async def talking(server: LocalServer) -> AsyncIterator[Talk]:
    """A stream whose client has sent hello."""
    async with grpc.aio.insecure_channel(server.address) as channel:
        stub = service_pb2_grpc.MotionServiceStub(channel)
        catalog = await stub.GetCatalog(service_pb2.GetCatalogRequest())
        talk = Talk(stub, catalog)  # type: ignore[arg-type]
        yield await talk.hello()
        talk.call.cancel()


@asynccontextmanager
async def flooded(talk: Talk, server: LocalServer, waiting_bytes: int) -> AsyncIterator[None]:
    """Sends without reading until that much waits for this client; a pending write is cancelled at the end."""
    enough = False
    talk.note(NOTHING)

    async def send() -> None:
        while not enough:
            await talk.call.write(NOTHING)

    sending = asyncio.create_task(send())
    await until_true(lambda: server.service.num_waiting_bytes > waiting_bytes)
    enough = True
    yield
    sending.cancel()
    await asyncio.gather(sending, return_exceptions=True)


async def closing(talk: Talk, handle: int) -> session_pb2.SessionClosed:
    """Reads everything up to the end of a session."""
    while isinstance(response := await talk.call.read(), service_pb2.StreamMotionResponse):
        for update in response.updates:
            if update.session == handle and update.HasField("closed"):
                return update.closed
    raise AssertionError("the stream ended before the session")


@pytest.mark.parametrize(
    "limits",
    [
        Limits(
            stream_events_per_second=UNMETERED, soft_backlog_bytes=1 << 30, hard_backlog_bytes=512 * KIB, backlog_s=3600
        ),
        Limits(
            stream_events_per_second=UNMETERED, soft_backlog_bytes=64 * KIB, hard_backlog_bytes=1 << 30, backlog_s=0.05
        ),
    ],
    ids=["too much at once", "a lot for too long"],
)
async def test_slow_reader_loses_its_sessions_and_is_told_once_it_reads(limits: Limits) -> None:
    least = min(limits.soft_backlog_bytes, limits.hard_backlog_bytes)
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(limits, service_limits=NO_BUDGET) as server,
        talking(server) as slow,
        talking(server) as other,
    ):
        await other.open(1)
        await slow.open(1)
        async with flooded(slow, server, least):
            while server.engine.num_sessions > 1:
                await other.ping(1)
            await other.plays_on(1)
            assert (await closing(slow, 1)).reason == session_pb2.CLOSE_REASON_SLOW_READER


async def test_client_that_reads_again_in_time_keeps_its_sessions() -> None:
    limits = Limits(
        stream_events_per_second=UNMETERED, soft_backlog_bytes=64 * KIB, hard_backlog_bytes=1 << 30, backlog_s=3600
    )
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(limits, service_limits=NO_BUDGET) as server,
        talking(server) as slow,
    ):
        await slow.open(1)
        async with flooded(slow, server, limits.soft_backlog_bytes):
            reading = asyncio.create_task(slow.to_the_end())
            await until_true(lambda: not server.service.num_waiting_bytes)
            reading.cancel()
            assert server.engine.num_sessions == 1


async def test_session_whose_client_sends_nothing_is_closed_as_idle() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(engine_config=EngineConfig(idle_timeout_s=0.2)) as server,
        talking(server) as silent,
    ):
        heard = await silent.open(1)
        await silent.until(lambda: heard.closed is not None)
        assert heard.closed is not None
        assert heard.closed.reason == session_pb2.CLOSE_REASON_IDLE


async def test_cancelled_call_ends_its_sessions_and_their_running_windows() -> None:
    running, goes_on = set[int](), threading.Event()

    def fails(call: str, job_ids: Sequence[int]) -> bool:
        """Holds the engine within the first step of a window of ten steps."""
        held = {each for each in job_ids if call == "denoise" and server.runner.jobs[each].num_steps == 10}
        running.update(held)
        return bool(held) and not goes_on.wait(LIMIT_S)

    limits = Limits(resume_grace_s=0)
    async with asyncio.timeout(LIMIT_S), LocalServer(limits) as server, talking(server) as other:
        server.runner.fails = fails
        await other.open(1)
        async with talking(server) as gone:
            for handle in range(20):
                await gone.open(handle)
            await gone.ask_open(20, denoise_steps=10)
            await until_true(lambda: running)
            gone.call.cancel()
            await until_true(lambda: server.service.num_streams == 1)
        goes_on.set()
        while server.engine.num_sessions > 1:
            await other.ping(1)
        await other.plays_on(1)
        assert running <= {*server.runner.discarded} - {*server.runner.decoded}
