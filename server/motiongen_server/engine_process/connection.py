"""Connection: the gateway's connection to one engine process, from the start of the process to its end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import zmq

from motiongen_server.engine_process.bell import Bell
from motiongen_server.engine_process.child import StartChild
from motiongen_server.engine_process.codec import Codec, CodecError
from motiongen_server.engine_process.messages import (
    GREETING,
    SCHEMA,
    TO_ENGINE,
    TO_GATEWAY,
    Begin,
    Ended,
    Events,
    Greeting,
    Joined,
    ToEngine,
    ToGateway,
)
from motiongen_server.engine_process.sockets import GatewayEnd, poller_of

GREETING_S = 60.0
"""How long an engine process may take to send its first message; it only has to import this package."""
CLOCK_TOLERANCE_S = 60.0
LAST_READ_MS = 100
TOLD_S = 0.5
"""How long to wait for the system to tell how a dead process ended."""


class EngineLost(RuntimeError):
    """The engine process ended, hung or sent an invalid message; the text says which."""


class LoadFailed(EngineLost):
    """The engine process continues, but failed to load a model for an unexpected reason."""


class Stopped(Exception):
    """Raised by a wait when the gateway is asked to stop."""


class Connection:
    """Used by one thread; `kill` may be called from any."""

    def __init__(
        self,
        start: StartChild,
        bell: Bell,
        is_stopping: Callable[[], bool],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Start the process. bell: ends every wait. environment: variables in addition to this process's.

        Raises SettingError or OSError if that is impossible.
        """
        self._end = GatewayEnd()
        try:
            self._child = start(self._end.folder, environment or {})
        except OSError:
            self._end.close()
            raise
        self._bell = bell
        self._is_stopping = is_stopping
        self._has_died = False
        self._has_left = False  # its sockets are closed; if it has died, its descriptor says so
        said: list[zmq.Socket[bytes] | int] = [self._end.back, bell.fileno(), self._child.fileno()]
        self._news = poller_of(said)
        self._news_or_room = poller_of(said, self._end.events)

    @property
    def pid(self) -> int:
        return self._child.pid

    # ---- the handshake ----------------------------------------------------------------------------------------------

    def begin(self, message: Begin) -> None:
        """Do the handshake. Raises EngineLost, or Stopped if asked to stop meanwhile."""
        greeting = self._await(GREETING, Greeting)
        if greeting.schema != SCHEMA:
            raise EngineLost(f"the engine process speaks schema {greeting.schema}, this one {SCHEMA}: mixed versions")
        apart_s = time.monotonic() - greeting.clock_at
        if not 0 <= apart_s < CLOCK_TOLERANCE_S:
            raise EngineLost(f"the engine process's monotonic clock is {apart_s:g} s from this one's")
        for socket in (self._end.events, self._end.ahead):
            self._send_first(socket, message)
        self._await(TO_GATEWAY, Joined)
        self._end.seal()

    def _send_first(self, socket: zmq.Socket[bytes], message: Begin) -> None:
        """Send once it has connected to this socket, which may be after its greeting has arrived."""
        ends_at = time.monotonic() + GREETING_S
        connected_or_died = poller_of([self._bell.fileno(), self._child.fileno()], socket)
        while not socket.poll(0, zmq.POLLOUT):
            self._check_patience(ends_at, "has not connected")
            ready = connected_or_died.poll(500)
            self._bell.quiet()
            if any(each == self._child.fileno() for each, _ in ready):
                raise EngineLost(f"the engine process {self._child.ended(TOLD_S)} before it was ready")
        self._push(socket, message)

    def _check_patience(self, ends_at: float, what: str) -> None:
        if self._is_stopping():
            raise Stopped
        if time.monotonic() > ends_at:
            raise EngineLost(f"the engine process {what} within {GREETING_S:g} s")

    def _await(self, codec: Codec[Any], kind: type[Any]) -> Any:
        """The next message, which must be of this kind."""
        ends_at = time.monotonic() + GREETING_S
        while (data := self._receive()) is None:
            self._check_patience(ends_at, f"said no {kind.__name__}")
            self.wait(0.5, for_room=False)
            self._bell.quiet()
            if self._has_died and (data := self._receive(LAST_READ_MS)) is None:
                raise EngineLost(f"the engine process {self._child.ended(TOLD_S)} before it was ready")
            if data is not None:
                break
        message = _decoded(codec, data)
        if isinstance(message, Ended):
            raise EngineLost(message.error)
        if not isinstance(message, kind):
            raise EngineLost(f"the engine process said {type(message).__name__} where {kind.__name__} was due")
        return message

    # ---- sending and receiving --------------------------------------------------------------------------------------

    @property
    def has_room(self) -> bool:
        """Whether one more message of events can be sent."""
        return bool(self._end.events.poll(0, zmq.POLLOUT))

    def send(self, events: Events) -> None:
        """Send events, if `has_room`. If the process has died nothing is sent, and `next_message` raises EngineLost."""
        self._push(self._end.events, events)

    def send_ahead(self, message: ToEngine) -> None:
        """Send a message that overtakes waiting events. If the process has died, as for `send`."""
        self._push(self._end.ahead, message)

    def _push(self, socket: zmq.Socket[bytes], message: ToEngine) -> None:
        try:
            socket.send(TO_ENGINE.encode(message), zmq.NOBLOCK)
        except zmq.Again:  # there was room, so the other side is gone; never wait for it
            self._has_left = True

    def wait(self, timeout_s: float, for_room: bool) -> None:
        """Wait until it sends something or dies, the bell rings, or (for_room) events can be sent."""
        poller = self._news_or_room if for_room else self._news
        self._has_died = any(ready == self._child.fileno() for ready, _ in poller.poll(int(1000 * timeout_s)))

    def next_message(self) -> ToGateway | None:
        """Its next message; None if there is none now. Raises EngineLost if that is invalid, or the process died."""
        data = self._receive()
        if data is None and (self._has_died or self._has_left):
            data = self._receive(LAST_READ_MS)
            if data is None:
                how = self._child.ended(TOLD_S) if self._has_died else "takes no messages any more"
                raise EngineLost(f"the engine process {how}")
        if data is None:
            return None
        message: ToGateway = _decoded(TO_GATEWAY, data)
        return message

    def _receive(self, patience_ms: int = 0) -> bytes | None:
        if patience_ms and not self._end.back.poll(patience_ms):
            return None
        try:
            return self._end.back.recv(zmq.NOBLOCK)
        except zmq.Again:
            return None

    # ---- the end ----------------------------------------------------------------------------------------------------

    def kill(self) -> None:
        self._child.kill()

    def close(self, patience_s: float = 0.0) -> None:
        """End the process, killing it after `patience_s`, and drop what it has not received."""
        self._child.end(patience_s)
        self._child.close()
        self._end.close()


def _decoded(codec: Codec[Any], data: bytes) -> Any:
    try:
        return codec.decode(data)
    except CodecError as error:
        raise EngineLost(f"the engine process said what is no message: {error}") from error
