"""The path by which engines' outputs and reports leave the process; engines never wait for it."""

from __future__ import annotations

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence

import zmq

from motiongen_server.engine.types import Output
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.messages import TO_GATEWAY, Outputs, Pulse, ToGateway
from motiongen_server.engine_process.sockets import LAST_WORDS_MS

PULSE_EVERY_S = 0.1
MOST_REPORTS = 4096
"""Reports kept for a gateway that does not read; the oldest are dropped, and its metrics then miss those steps."""


class Wire:
    """Sends messages while the gateway reads, and otherwise queues them in order. Used from any thread.

    The queue is bounded because no events are taken in while it is blocked: without playheads no session may be sent
    more than its look-ahead.
    """

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self._lock = threading.Lock()  # for the socket, which is not thread-safe
        self._unsent: deque[bytes] = deque()
        self.is_blocked = False
        """Whether messages wait because the gateway does not read fast enough."""
        self.on_blocked: Callable[[], None] = lambda: None
        """Called when `is_blocked` becomes true: `flush` must then be called until it is false."""

    def say(self, message: ToGateway) -> None:
        """Send a message, now or after those that wait. Raises CodecError if it cannot be encoded."""
        self.send(TO_GATEWAY.encode(message))

    def send(self, data: bytes) -> None:
        """Send a message that is already encoded, as `say` does."""
        with self._lock:
            self._unsent.append(data)
            self._flush()

    def flush(self) -> None:
        """Send as many waiting messages as the gateway takes."""
        if self._unsent:
            with self._lock:
                self._flush()

    def _flush(self) -> None:
        while self._unsent:
            try:
                self._socket.send(self._unsent[0], zmq.NOBLOCK)
            except zmq.Again:
                if not self.is_blocked:
                    self.is_blocked = True
                    self.on_blocked()
                return
            self._unsent.popleft()
        self.is_blocked = False

    def finish(self) -> None:
        """Before the end: send what still waits, for up to `LAST_WORDS_MS` for each message."""
        with self._lock, contextlib.suppress(zmq.Again):
            self._socket.setsockopt(zmq.SNDTIMEO, LAST_WORDS_MS)
            while self._unsent:
                self._socket.send(self._unsent[0])
                self._unsent.popleft()


class Outlet:
    """Sends the outputs and reports of one slot's engine. Used by the engine's thread."""

    def __init__(self, wire: Wire, slot: int) -> None:
        self._wire = wire
        self._slot = slot
        self._reports: deque[StepReport] = deque(maxlen=MOST_REPORTS)
        self._next_pulse_at = 0.0

    def deliver(self, outputs: Sequence[Output]) -> None:
        """The engine's Deliver."""
        self._wire.say(Outputs(self._slot, tuple(outputs)))

    def observe(self, report: StepReport) -> None:
        """The engine's Observe. Collects reports for `PULSE_EVERY_S`, since each message costs both processes time."""
        now = time.monotonic()
        self._reports.append(report)
        if now >= self._next_pulse_at and not self._wire.is_blocked:
            self._next_pulse_at = now + PULSE_EVERY_S
            reports = tuple(self._reports)
            self._reports.clear()
            self._wire.say(Pulse(self._slot, now, reports))
