"""Outlet: the engine's way out. Neither its outputs nor its reports ever make it wait."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Sequence

import zmq

from motiongen_server.engine.scheduling.report import StepReport
from motiongen_server.engine.types import Output
from motiongen_server.engine_process.messages import TO_GATEWAY, Outputs, Pulse, ToGateway
from motiongen_server.engine_process.sockets import LAST_WORDS_MS

PULSE_EVERY_S = 0.1
MOST_REPORTS = 4096
"""Reports kept for a gateway that does not read; the oldest go first, and its metrics then miss those steps."""


class Outlet:
    """Sends while the gateway reads, and else keeps what there is to say, in order.

    What it keeps is bounded because `Inlet` takes no events while it is blocked: without playheads no session may be
    sent more than its lookahead. Used by the engine's thread.
    """

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self._unsent: deque[bytes] = deque()
        self._reports: deque[StepReport] = deque(maxlen=MOST_REPORTS)
        self._next_pulse_at = 0.0

    @property
    def is_blocked(self) -> bool:
        """Whether the gateway has as much to read as may wait."""
        return bool(self._unsent)

    def deliver(self, outputs: Sequence[Output]) -> None:
        """The engine's Deliver."""
        self.say(Outputs(tuple(outputs)))

    def observe(self, report: StepReport) -> None:
        """The engine's Observe. Reports are gathered for a while, since each message costs both processes."""
        now = time.monotonic()
        self._reports.append(report)
        if now >= self._next_pulse_at and not self.is_blocked:
            self._next_pulse_at = now + PULSE_EVERY_S
            reports = tuple(self._reports)
            self._reports.clear()
            self.say(Pulse(now, reports))

    def say(self, message: ToGateway) -> None:
        """Send a message, now or after those that wait. Raises CodecError for what cannot be encoded."""
        self._unsent.append(TO_GATEWAY.encode(message))
        self.flush()

    def flush(self) -> None:
        """Send what the gateway will take."""
        while self._unsent:
            try:
                self._socket.send(self._unsent[0], zmq.NOBLOCK)
            except zmq.Again:
                return
            self._unsent.popleft()

    def finish(self) -> None:
        """Before the end: wait a moment for what could not be sent yet."""
        self._socket.setsockopt(zmq.SNDTIMEO, LAST_WORDS_MS)
        with contextlib.suppress(zmq.Again):
            while self._unsent:
                self._socket.send(self._unsent[0])
                self._unsent.popleft()
