"""Inlet: the engine's way in. Its loop reads the sockets itself, between two steps or while it has nothing to do."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import zmq

from motiongen_server.engine.types import Event
from motiongen_server.engine_process.arrivals import Arrivals
from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.codec import CodecError
from motiongen_server.engine_process.messages import TO_ENGINE, CloseAhead, Events, Stop, ToEngine
from motiongen_server.engine_process.outlet import Outlet
from motiongen_server.engine_process.sockets import EngineEnd, poller_of


class Inlet:
    """The `Inbox` of an engine in a process of its own. `stop` is called when the gateway asks for it."""

    def __init__(self, end: EngineEnd, outlet: Outlet, stop: Callable[[], None]) -> None:
        self._end = end
        self._outlet = outlet
        self._stop = stop
        self._arrivals = Arrivals()
        self._handed_in: deque[Event] = deque()
        self._bell = Bell()
        self._news = poller_of([end.ahead, self._bell.fileno(), end.events])
        self._news_or_room = poller_of([end.ahead, self._bell.fileno()], end.back)

    def put(self, event: Event) -> bool:
        """From this process, beside what the gateway sends. Always taken."""
        self._handed_in.append(event)
        self._bell.ring()
        return True

    def take_all(self) -> list[Event]:
        """All events that are here, those that go ahead first. Raises CodecError for what is no message.

        While the gateway does not read, only closes and Stop are taken: what waits on both ways stays bounded.
        """
        self._bell.quiet()
        self._outlet.flush()
        taken = [self._handed_in.popleft() for _ in range(len(self._handed_in))]
        while (message := self._receive(self._end.ahead)) is not None:
            if isinstance(message, CloseAhead):
                taken += self._arrivals.ahead(message)
            elif isinstance(message, Stop):
                self._stop()
            else:
                raise CodecError(f"{type(message).__name__} came on the way for what goes ahead")
        while not self._outlet.is_blocked and (message := self._receive(self._end.events)) is not None:
            if not isinstance(message, Events):
                raise CodecError(f"{type(message).__name__} came on the way for events")
            taken += self._arrivals.in_order(message)
        return taken

    def wait(self, timeout_s: float) -> None:
        """Until something has come or the time has passed; what the gateway takes meanwhile is sent."""
        ends_at = time.monotonic() + timeout_s
        poller = self._news_or_room if self._outlet.is_blocked else self._news
        while (left_s := ends_at - time.monotonic()) > 0:
            if poller.poll(max(1, int(1000 * left_s))):
                return

    def ring(self) -> None:
        """End the current or the next `wait` without an event, from any thread."""
        self._bell.ring()

    def close(self) -> None:
        self._bell.close()

    @staticmethod
    def _receive(socket: zmq.Socket[bytes]) -> ToEngine | None:
        try:
            data = socket.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None
        return TO_ENGINE.decode(data)
