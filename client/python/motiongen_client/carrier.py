"""Carrier: the interface of a stream towards its sessions."""

from __future__ import annotations

from typing import Protocol

from motiongen.v1 import session_pb2
from motiongen_client.backlog import Backlog
from motiongen_client.errors import EventRefused


class Carrier(Protocol):
    """What a session needs of the stream that carries it. backlog: accounts for what waits to be sent."""

    @property
    def backlog(self) -> Backlog: ...

    @property
    def call_number(self) -> int:
        """The number of the present call; it rises with each reconnection."""

    @property
    def is_connected(self) -> bool:
        """Whether there is a call at present."""

    @property
    def draining(self) -> bool:
        """Whether the server has sent a Goodbye."""

    @property
    def recovers(self) -> bool:
        """Whether a lost call is followed by another."""

    def check(self, event: session_pb2.SessionEvent) -> None:
        """Raise InvalidInput for an event that is too big to be sent."""

    def send(self, event: session_pb2.SessionEvent) -> None:
        """Queue an event for the next message. It is dropped while the connection is lost."""

    def report_soon(self) -> None:
        """Report playheads without waiting for the next regular report."""

    def move_elsewhere(self, handle: int, refusal: EventRefused) -> bool:
        """Try to have another server continue a session for which this one has no free capacity.

        Meanwhile the session waits: it is moved to another stream, or `wait_for_room` is called. Returns False if no
        other server is known.
        """
