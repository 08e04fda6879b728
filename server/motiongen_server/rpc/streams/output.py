"""StreamOutput: what one stream still has to write, and its limits for a client that does not read."""

from __future__ import annotations

import asyncio
import time
from abc import ABC, abstractmethod
from collections import deque

from motiongen.v1 import service_pb2
from motiongen_server.rpc.budgets.gateway_lag import GatewayLag
from motiongen_server.rpc.budgets.loop_time import Work
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.send_queue import SendQueue
from motiongen_server.rpc.stream_metrics import StreamMetrics
from motiongen_server.rpc.streams.reader_patience import ReaderPatience
from motiongen_server.rpc.streams.response import response_of
from motiongen_server.rpc.streams.tracing import StreamTracing

MAX_RESPONSE_BYTES = 1 << 20
MAX_WAITING_REPLIES = 64
REPLY_BYTES = 512
"""A pong or a goodbye in memory, roughly."""


class StreamOutput(ABC):
    """The part of a `Stream` that its write loop uses. ready: there is something to write, or the stream has ended.

    urgent: something must not wait for the flush interval. work: measures the event loop's work for the client.
    """

    def __init__(self, limits: Limits, stream_metrics: StreamMetrics, work: Work) -> None:
        self.work = work
        self.send_queue = SendQueue()
        self.ready = asyncio.Event()
        self.urgent = asyncio.Event()
        self.ended = False
        self.tracing: StreamTracing | None = None
        self.writing_since: float | None = None  # monotonic seconds, while a message is being written
        self.has_written = False  # a message, to its end
        self.gateway_lag: GatewayLag | None = None  # of the event loop, which all streams share
        self.responses: deque[service_pb2.StreamMotionResponse] = deque()
        self._limits = limits
        self._stream_metrics = stream_metrics
        self._writing_bytes = 0  # of the message that is being written
        self._dropped_told = 0
        self._patience = ReaderPatience(limits, self._give_up_on_reader)
        self._room = asyncio.Event()
        self._probe: asyncio.Future[None] | None = None

    @abstractmethod
    def _give_up_on_reader(self) -> None:
        """Too much waits for the client."""

    @property
    def num_waiting_bytes(self) -> int:
        """Roughly the bytes that wait to be written, or are being written."""
        return self.send_queue.num_bytes + REPLY_BYTES * len(self.responses) + self._writing_bytes

    def next_response(self) -> bytes | None:
        """The next StreamMotionResponse: first pongs and goodbyes, then updates of many sessions in one message."""
        self._room.set()
        response = self._next_response()
        self._writing_bytes = 0 if response is None else len(response)
        return response

    def _next_response(self) -> bytes | None:
        if self.responses:
            return self.responses.popleft().SerializeToString()
        waiting = self.send_queue.take(MAX_RESPONSE_BYTES)
        self._check_backlog()
        if not waiting:
            return None
        if self.tracing is not None:
            self.tracing.take(waiting)
        return response_of(waiting, self.work)

    def reply(self, response: service_pb2.StreamMotionResponse) -> None:
        """Send a message that belongs to no session ahead of the updates."""
        self.responses.append(response)
        self.urgent.set()
        self.ready.set()

    def probe(self) -> asyncio.Future[None]:
        """After the client has finished: a future that is done once another message was written, so that the connection
        is known to be there."""
        self._probe = asyncio.get_running_loop().create_future()
        self.reply(service_pb2.StreamMotionResponse())
        return self._probe

    def note_written(self) -> None:
        """The last result of `next_response` was written."""
        if self.gateway_lag is not None and self.writing_since is not None:
            self.gateway_lag.note_write(time.monotonic() - self.writing_since)
        self.writing_since = None
        self._writing_bytes = 0
        self.has_written = True
        if self.tracing is not None:
            self.tracing.note_written()
        if self._probe is not None and not self.responses and not self._probe.done():
            self._probe.set_result(None)

    @property
    def _is_backlogged(self) -> bool:
        full = self.send_queue.excess_bytes > self._limits.hard_backlog_bytes
        return full or len(self.responses) > MAX_WAITING_REPLIES

    def _check_backlog(self) -> None:
        """Close every session if the client reads too slowly: too much is unsent, or a lot for too long.

        A look-ahead of frames of each session does not count: that much is sent to clients that read at real time too.
        """
        if self.send_queue.dropped_frames > self._dropped_told:
            self._stream_metrics.drop_frames(self.send_queue.dropped_frames - self._dropped_told)
            self._dropped_told = self.send_queue.dropped_frames
        self._patience.check(self.send_queue.excess_bytes)

    def end(self) -> None:
        """Let the write loop write what is there, and stop."""
        self.ended = True
        self._room.set()
        self.urgent.set()
        self.ready.set()
