"""Writing to clients: what waits for the flush interval, and how streams end during a write."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc.aio
import numpy as np
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.engine.types import Chunk, Close, Closed, CloseReason, Code, PlanCause, PlanNotice, SessionKey
from motiongen_server.rpc.errors.streams import stream_empty
from motiongen_server.rpc.service import MotionService
from motiongen_server.rpc.streams import writer as stream_writer
from tests.server.rpc.streams.test_event_order import Line

ENDLESS_S = 1e6
SOON_S = 30.0
ROW_WIDTH = 11


class Context:
    """The context of a client that reads everything at once. messages: what was written to it."""

    def __init__(self) -> None:
        self.messages: asyncio.Queue[bytes] = asyncio.Queue()

    async def write(self, message: bytes) -> None:
        self.messages.put_nowait(message)

    async def next_updates(self) -> list[session_pb2.SessionUpdate]:
        message = await asyncio.wait_for(self.messages.get(), SOON_S)
        return list(service_pb2.StreamMotionResponse.FromString(message).updates)

    async def is_silent(self) -> bool:
        """Whether nothing is written during 50 iterations of the event loop."""
        for _ in range(50):
            await asyncio.sleep(0)
        return self.messages.empty()


def line_to(context: Context) -> tuple[Line, asyncio.Task[None]]:
    """A stream to that client, and the task that writes to it until it is cut."""
    line = Line()
    writer = asyncio.create_task(stream_writer.write(line.stream, context))  # type: ignore[arg-type]
    line.stream.cut = lambda: stream_writer.cut(line.stream, writer)
    return line, writer


@asynccontextmanager
async def written() -> AsyncIterator[tuple[Line, SessionKey, Context, asyncio.Task[None]]]:
    """A stream with an endless flush interval to a client that has just been sent something."""
    context = Context()
    line, writer = line_to(context)
    line.stream.flush_s = ENDLESS_S
    line.open()
    assert await context.next_updates()
    yield line, line.engine.events[0].session, context, writer
    writer.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await writer


def chunk(key: SessionKey, plan: int) -> Chunk:
    return Chunk(key, plan, 0, np.zeros((8, ROW_WIDTH), np.float32), 0)


async def test_frames_wait_for_the_flush_interval() -> None:
    async with written() as (line, key, context, _):
        line.stream.take(PlanNotice(key, 2, 0, PlanCause.CONTINUE, ()), chunk(key, 2))
        assert await context.is_silent()


async def test_plan_that_answers_an_edit_is_sent_at_once_with_its_frames() -> None:
    async with written() as (line, key, context, _):
        line.stream.take(chunk(key, 1))
        assert await context.is_silent()
        line.stream.take(PlanNotice(key, 2, 8, PlanCause.EDIT, (2,)), chunk(key, 2))
        said = [update.WhichOneof("update") for update in await context.next_updates()]
        assert said.count("plan") == 1
        assert "chunk" in said[said.index("plan") :]
        line.stream.take(PlanNotice(key, 3, 8, PlanCause.CONTINUE, ()), chunk(key, 3))
        assert await context.is_silent()


class GoneContext(Context):
    """A client that leaves while its first message is being written, which gRPC has not noticed yet."""

    async def read(self) -> bytes:
        await asyncio.Event().wait()
        raise AssertionError("it says nothing")

    async def write(self, message: bytes) -> None:
        raise grpc.aio.InternalError("a write of the call has failed")


async def test_call_whose_client_has_gone_is_cancelled_and_its_session_closed() -> None:
    line = Line()
    line.open()
    service = MotionService(line.models)
    with pytest.raises(asyncio.CancelledError):
        await service._serve(line.stream, GoneContext())  # type: ignore[arg-type]
    assert line.engine.kinds()[-1] is Close


class SlowContext(Context):
    """A client that takes messages only while `reads` is set."""

    def __init__(self) -> None:
        super().__init__()
        self.reads = asyncio.Event()

    async def write(self, message: bytes) -> None:
        await self.reads.wait()
        await super().write(message)


async def test_pending_write_is_finished_before_a_refused_stream_ends() -> None:
    """gRPC drops a status that is set while the first response is being written: the client would not get it."""
    context = SlowContext()
    line, writer = line_to(context)
    line.open()
    assert await context.is_silent()
    line.stream.take(chunk(line.engine.events[0].session, 1))
    line.stream.refuse(stream_empty(300.0))
    assert await context.is_silent()
    assert not writer.done()
    context.reads.set()
    await asyncio.wait_for(writer, SOON_S)
    assert context.messages.qsize() == 1, "nothing is written after it"


async def test_client_that_takes_nothing_more_does_not_hold_up_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_writer, "LAST_WRITE_S", 0.01)
    context = SlowContext()
    line, writer = line_to(context)
    context.reads.set()
    line.open()
    assert await context.next_updates()
    context.reads.clear()
    line.stream.take(PlanNotice(line.engine.events[0].session, 2, 0, PlanCause.EDIT, (2,)))
    assert await context.is_silent()
    line.stream.refuse(stream_empty(300.0))
    await asyncio.wait({writer}, timeout=SOON_S)
    assert writer.cancelled()


async def test_pending_write_of_the_first_message_is_never_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """gRPC would hold the call without anything counting it."""
    monkeypatch.setattr(stream_writer, "LAST_WRITE_S", 0.0)
    context = SlowContext()
    line, writer = line_to(context)
    line.open()
    assert await context.is_silent()
    line.stream.refuse(stream_empty(300.0))
    assert await context.is_silent()
    assert not writer.done()
    context.reads.set()
    await asyncio.wait_for(writer, SOON_S)


async def test_refused_stream_without_a_pending_write_ends_at_once() -> None:
    async with written() as (line, _, context, writer):
        line.stream.refuse(stream_empty(300.0))
        await asyncio.wait({writer}, timeout=SOON_S)
        assert writer.cancelled()
        assert context.messages.empty()


async def test_failed_stream_ends_after_its_pending_write_despite_open_sessions() -> None:
    context = SlowContext()
    line, writer = line_to(context)
    line.open()
    assert await context.is_silent()
    line.stream.fail(RuntimeError("a bug"))
    assert line.stream.num_sessions == 1
    context.reads.set()
    await asyncio.wait_for(writer, SOON_S)


async def test_ending_stream_sends_the_ends_of_its_sessions_first() -> None:
    async with written() as (line, key, context, writer):
        line.stream.close_all(CloseReason.DRAINED)
        line.stream.end()
        assert await context.is_silent()
        assert not writer.done(), "the engine has not confirmed the end yet"
        line.stream.take(Closed(key, CloseReason.DRAINED, Code.OK, "", 0, 0))
        (told,) = await context.next_updates()
        assert told.HasField("closed")
        await asyncio.wait_for(writer, SOON_S)
