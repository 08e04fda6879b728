"""Streams that use their place for nothing, exceed the limit of streams, or send bytes that are no message."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import NoReturn

import grpc
import grpc.aio
import numpy as np
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from motiongen_server.engine.types import Chunk, Code, SessionKey
from motiongen_server.identity.callers import Callers
from motiongen_server.rpc.handlers import SERVICE_NAME
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.rpc.streams.watch import StreamWatch
from tests.contract.local import LocalServer
from tests.server.engine.fakes import ROW_WIDTH
from tests.server.rpc.streams.test_event_order import Line
from tests.waiting import LIMIT_S, until_true


@asynccontextmanager
async def connected(server: LocalServer) -> AsyncIterator[tuple[grpc.aio.Channel, service_pb2.GetCatalogResponse]]:
    async with grpc.aio.insecure_channel(server.address) as channel:
        stub = service_pb2_grpc.MotionServiceStub(channel)
        yield channel, await stub.GetCatalog(service_pb2.GetCatalogRequest())


def talk_on(channel: grpc.aio.Channel, catalog: service_pb2.GetCatalogResponse) -> Talk:
    return Talk(service_pb2_grpc.MotionServiceStub(channel), catalog)  # type: ignore[arg-type]


async def end_of(talk: Talk) -> tuple[grpc.StatusCode, str]:
    """The status and the reason with which the server ends a stream."""
    code = await talk.to_the_end()
    status = rpc_status.from_call(
        grpc.aio.AioRpcError(
            code, await talk.call.initial_metadata(), await talk.call.trailing_metadata(), await talk.call.details()
        )
    )
    info = error_details_pb2.ErrorInfo()
    for detail in status.details if status is not None else ():
        detail.Unpack(info)
    return code, info.reason


@pytest.mark.parametrize(
    ("limits", "says_hello", "reason"),
    [
        (ServiceLimits(hello_timeout_s=0.1), False, "HELLO_LATE"),
        (ServiceLimits(hello_timeout_s=LIMIT_S, empty_timeout_s=0.1), True, "STREAM_EMPTY"),
    ],
    ids=["no hello", "no session"],
)
async def test_stream_without_hello_or_without_sessions_is_ended(
    limits: ServiceLimits, says_hello: bool, reason: str
) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        connected(server) as (channel, catalog),
    ):
        talk = talk_on(channel, catalog)
        if says_hello:
            await talk.hello()
        assert await end_of(talk) == (grpc.StatusCode.DEADLINE_EXCEEDED, reason)
        await until_true(lambda: not server.service.num_streams)


async def test_stream_is_ended_as_empty_only_without_sessions() -> None:
    # As the clock leaps, what is being written at that moment would be stuck.
    limits = ServiceLimits(empty_timeout_s=300.0, silent_timeout_s=1e6, stuck_timeout_s=1e6)
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        connected(server) as (channel, catalog),
    ):
        played, empty = talk_on(channel, catalog), talk_on(channel, catalog)
        await (await played.hello()).open(1)
        await empty.hello()
        server.service.watch.look(time.monotonic() + 301.0)
        assert (await end_of(empty))[1] == "STREAM_EMPTY"
        await played.plays_on(1)
        await played.close(1)
        server.service.watch.look(time.monotonic() + 301.0)
        assert (await end_of(played))[1] == "STREAM_EMPTY"


@pytest.mark.parametrize("limits", [ServiceLimits(max_streams=1), ServiceLimits(peer=PeerLimits(streams=1))])
async def test_streams_are_limited_and_an_ended_one_frees_its_place(limits: ServiceLimits) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        connected(server) as (channel, catalog),
    ):
        first = await talk_on(channel, catalog).hello()
        assert await end_of(talk_on(channel, catalog)) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_STREAMS")
        first.call.cancel()
        await until_true(lambda: not server.service.num_streams)
        await talk_on(channel, catalog).hello()


async def test_bytes_that_are_no_message_end_only_their_stream() -> None:
    async with asyncio.timeout(LIMIT_S), LocalServer() as server, connected(server) as (channel, catalog):
        other = await talk_on(channel, catalog).hello()
        await other.open(1)
        for garbage in (b"\x0a\xff", b"\x0a\x7f" * 5000):
            call = channel.stream_stream(f"/{SERVICE_NAME}/StreamMotion")()
            await call.write(garbage)
            assert await call.code() is grpc.StatusCode.INVALID_ARGUMENT
            assert "could not be read" in await call.details()
        with pytest.raises(grpc.aio.AioRpcError, match="could not be read"):
            await anext(aiter(channel.unary_stream(f"/{SERVICE_NAME}/GenerateClip")(b"\x0a\xff")))
        await other.plays_on(1)


async def test_event_and_clip_with_too_many_fields_are_refused_and_a_session_plays_on() -> None:
    parts = [motion_pb2.Constraint()] * 100_000
    async with asyncio.timeout(LIMIT_S), LocalServer() as server, connected(server) as (channel, catalog):
        talk = await talk_on(channel, catalog).hello()
        await talk.open(1)
        edit = session_pb2.EditConstraints(upsert=parts)
        refused = await talk.edit(1, session_pb2.SessionEvent(edit_constraints=edit))
        assert (refused.code, refused.reason, refused.field) == (Code.RESOURCE_EXHAUSTED, "TOO_MANY_FIELDS", "event")
        await talk.plays_on(1)
        clip = service_pb2.GenerateClipRequest(frame_count=40, open=session_pb2.OpenSession(constraints=parts))
        call = service_pb2_grpc.MotionServiceStub(channel).GenerateClip(clip)
        with pytest.raises(grpc.aio.AioRpcError, match="more than 4416 fields") as failed:
            await call.read()
        assert failed.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


async def test_calls_of_a_peer_in_debt_are_refused_with_the_time_to_wait() -> None:
    limits = ServiceLimits(peer=PeerLimits(calls_per_second=1e-6))  # the debt of one call outlasts any test
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        await stub.GetCatalog(service_pb2.GetCatalogRequest())
        with pytest.raises(grpc.aio.AioRpcError, match="ask again in") as refused:
            await stub.GetCatalog(service_pb2.GetCatalogRequest())
        assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED


def holding(num_frames: int) -> Stream:
    """A stream whose client does not read."""
    stream = Line().stream
    stream.greeted = True
    stream.number = num_frames
    stream.send_queue.put_chunk(Chunk(SessionKey(stream.number, 1), 1, 0, FRAMES[:num_frames], 0), 0)
    return stream


FRAMES = np.zeros((1000, ROW_WIDTH), np.float32)


async def test_streams_with_most_waiting_are_ended_when_memory_runs_out() -> None:
    streams = {stream.number: stream for stream in map(holding, (100, 200, 400, 500))}
    most = sum(stream.num_waiting_bytes for stream in streams.values()) // 2
    StreamWatch(ServiceLimits(max_waiting_bytes=most), streams).look(time.monotonic())
    assert [number for number, stream in streams.items() if stream.refusal is not None] == [400, 500]
    assert sum(stream.num_waiting_bytes for stream in streams.values()) <= most


async def test_streams_and_memory_are_watched_although_reading_of_files_fails(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(_callers: Callers) -> NoReturn:
        raise TypeError("unhashable type: 'list'")

    monkeypatch.setattr(Callers, "look", fail)
    stuck, greedy, now = holding(10), holding(500), time.monotonic()
    stuck.writing_since = now
    limits = ServiceLimits(stuck_timeout_s=30.0, max_waiting_bytes=greedy.num_waiting_bytes // 2)
    watch = StreamWatch(limits, {stream.number: stream for stream in (stuck, greedy)})
    for seconds in range(29, 33):
        watch.look(now + seconds)
    assert [stream.refusal is not None for stream in (stuck, greedy)] == [True, True]
    assert len(caplog.messages) == 1, "it is logged once in ten seconds, not four times a second"


async def test_stream_with_a_write_pending_for_too_long_is_ended() -> None:
    stream, now = holding(10), time.monotonic()
    watch = StreamWatch(ServiceLimits(stuck_timeout_s=30.0), {stream.number: stream})
    stream.writing_since = now
    watch.look(now + 29)
    assert stream.refusal is None
    cut = []
    stream.cut = lambda: cut.append(True)
    watch.look(now + 31)
    assert stream.refusal is not None
    assert stream.refusal.reason == "SLOW_READER"
    assert cut == [True]
    assert stream.num_waiting_bytes == 0


async def test_stream_of_a_silent_client_is_ended_and_its_session_can_be_resumed() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        # As the clock leaps, what is being written at that moment would be stuck.
        LocalServer(service_limits=ServiceLimits(silent_timeout_s=90.0, stuck_timeout_s=1000.0)) as server,
        connected(server) as (channel, catalog),
    ):
        talk = await talk_on(channel, catalog).hello()
        heard = await talk.open(1)
        await talk.plays_on(1)

        def is_lost() -> bool:
            server.service.watch.look(time.monotonic() + 91.0)
            return not server.service.num_streams

        await until_true(is_lost)  # it is not silent while the server still reads what it has sent
        assert await end_of(talk) == (grpc.StatusCode.UNAVAILABLE, "CLIENT_SILENT")
        again = await talk_on(channel, catalog).hello()
        await again.resume(1, heard)
        await again.plays_on(1)


async def test_silence_counts_only_while_the_server_reads_the_stream() -> None:
    stream, now = holding(1), time.monotonic()
    watch = StreamWatch(ServiceLimits(silent_timeout_s=90.0, empty_timeout_s=1e6), {stream.number: stream})
    watch.look(now + 1000.0)
    assert stream.refusal is None, "it is in debt, and is not being read"
    stream.listening_since = now
    watch.look(now + 89.0)
    assert stream.refusal is None
    watch.look(now + 91.0)
    assert stream.refusal is not None
    assert stream.refusal.reason == "CLIENT_SILENT"


@pytest.mark.parametrize("is_greeted", [False, True])
async def test_stream_that_is_ending_is_refused_neither_as_late_nor_as_empty(is_greeted: bool) -> None:
    """Its client has finished, and is told how the stream ended as slowly as it reads."""
    stream = Line().stream
    stream.greeted = is_greeted
    watch, much_later = StreamWatch(ServiceLimits(), {}), time.monotonic() + 1e6
    assert watch.refusal(stream, much_later) is not None
    stream.end()
    assert watch.refusal(stream, much_later) is None
