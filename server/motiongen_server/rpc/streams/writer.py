"""The write loop of a stream: gathers what waits into messages, at most one batch per flush interval."""

from __future__ import annotations

import asyncio
import time

from motiongen_server.rpc.calls.bounded_write import LAST_WRITE_S
from motiongen_server.rpc.errors.streams import CLIENT_GONE
from motiongen_server.rpc.handlers import StreamContext
from motiongen_server.rpc.streams.stream import Stream


async def write(stream: Stream, context: StreamContext) -> None:
    """Write what waits until the stream ends and all is written.

    What comes after a quiet time is written at once; what comes within the flush interval of the last message is
    gathered into the next. Raises CancelledError if the client has gone.
    """
    loop, next_at = asyncio.get_running_loop(), 0.0
    while True:
        await stream.ready.wait()
        if loop.time() < next_at:
            timer = loop.call_at(next_at, stream.urgent.set)
            await stream.urgent.wait()
            timer.cancel()
        if not stream.ended:
            stream.urgent.clear()
        stream.ready.clear()
        next_at = loop.time() + stream.flush_s
        while (response := stream.next_response()) is not None:
            stream.writing_since = time.monotonic()
            try:
                await context.write(response)
                stream.note_written()
            except CLIENT_GONE as error:
                stream.lose()
                raise asyncio.CancelledError from error  # else gRPC would send a status to a client that has gone
            if stream.is_cut:
                return
        if stream.ended and not stream.num_sessions and not len(stream.send_queue):
            return


def cut(stream: Stream, writer: asyncio.Task[None]) -> None:
    """End the writing of a stream; its status is sent next.

    The message being written has a moment to complete. The first response of a call may take as long as it needs, and
    the stream keeps its place meanwhile: until then gRPC takes no status, and would hold the call without one.
    """
    if stream.writing_since is None:
        writer.cancel()
    else:
        stream.is_cut = True
        if stream.has_written:
            asyncio.get_running_loop().call_later(LAST_WRITE_S, writer.cancel)
