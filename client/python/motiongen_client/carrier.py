"""Carrier: what a session needs of the stream that carries it."""

from __future__ import annotations

from typing import Protocol

from motiongen.v1 import session_pb2
from motiongen_client.backlog import Backlog
from motiongen_client.errors import EventRefused


class Carrier(Protocol):
    """What a session needs of the stream that carries it. backlog: of what waits there."""

    @property
    def backlog(self) -> Backlog: ...

    @property
    def call_number(self) -> int:
        """Rises with each call that takes the place of a lost one."""

    @property
    def is_connected(self) -> bool:
        """Whether there is a call at present."""

    @property
    def draining(self) -> bool:
        """Whether the server has said goodbye."""

    @property
    def recovers(self) -> bool:
        """Whether a lost call is followed by another."""

    def check(self, event: session_pb2.SessionEvent) -> None:
        """Raise InvalidInput for an event that is too big to be sent."""

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event; it goes out with the next message."""

    def report_soon(self) -> None:
        """Report playheads without waiting for the next regular report."""

    def move_elsewhere(self, handle: int, refusal: EventRefused) -> bool:
        """Try to have another server go on with a session that this one has no room for.

        The session waits meanwhile: it is moved to another stream, or told to `wait_for_room`. False: none is known.
        """
