"""Sending: gives each event of a session its number, and keeps it until the server has answered it."""

from __future__ import annotations

import logging
from abc import abstractmethod
from collections.abc import Callable

from motiongen.v1 import session_pb2
from motiongen_client.backlog import Unanswered
from motiongen_client.carrier import Carrier
from motiongen_client.cuts import Cuts
from motiongen_client.edit import Edit, EditBook
from motiongen_client.errors import EventRefused, InvalidInput, MotiongenError
from motiongen_client.frame_shift import passed_targets, shifted
from motiongen_client.repeating import Repeating

_log = logging.getLogger(__name__)


class Sending(Cuts):
    """The part of a `Session` that numbers events and sends them, if a server has the session at present."""

    def __init__(self, handle: int, carrier: Carrier, clock: Callable[[], float]) -> None:
        self.handle = handle
        self._carrier = carrier
        self._clock = clock
        self._failure: MotiongenError | None = None
        self._next_seq = 1
        self._edits = EditBook()
        self._unanswered = Unanswered(carrier.backlog)
        self._offset = 0  # the client's frame number of the server's frame 0
        self._said_to = 0  # the highest event number that the server's present session may have received
        self._repeating = Repeating(lambda: self._unanswered, self._transmit)
        self._is_refusing = False  # because too much waits in the backlog

    @property
    def last_seq(self) -> int:
        """The number of the newest event. Once `durable_seq` has reached it, all events survive the server's loss."""
        return self._next_seq - 1

    @property
    @abstractmethod
    def _is_attached(self) -> bool:
        """Whether events can be sent to the server now; otherwise they wait in `_unanswered`."""

    @property
    def _answered_seq(self) -> int:
        """Every event up to this number has been answered."""
        return self._unanswered.first(self._next_seq) - 1

    def _send_edit(
        self,
        what: str,
        event: session_pb2.SessionEvent,
        constraint_ids: tuple[int, ...] = (),
        prompt_id: int | None = None,
    ) -> Edit:
        """Send an edit. If the backlog is full, the returned edit is already refused (OUTBOX_FULL)."""
        self._check(event)
        if self._is_overtaking(event):
            edit = Edit(what, self.last_seq, self._clock())
            self._edits.put_in_place(edit)
            return edit
        refusal = self._refusal(what)
        edit = Edit(what, self._next_seq if refusal is None else 0, self._clock(), constraint_ids, prompt_id)
        if refusal is None:
            self._say(event)
            self._edits.add(edit)
        else:
            edit.settle(refusal)
        return edit

    def _is_overtaking(self, event: session_pb2.SessionEvent) -> bool:
        """If the newest event is a velocity that no server has received, replace it by this one. Whether it did."""
        newest = self._unanswered.get(self.last_seq)
        if newest is None or not (newest.HasField("set_velocity") and event.HasField("set_velocity")):
            return False
        if self.last_seq <= self._said_to or self._edits.find(self.last_seq) is None:
            return False
        newest.set_velocity.CopyFrom(event.set_velocity)
        return True

    def _refusal(self, what: str) -> EventRefused | None:
        """Why no event can be accepted at present, if so. Only the first of consecutive refusals is logged."""
        refusal = self._carrier.backlog.refusal(what, is_heard=self._is_attached)
        if refusal is not None and not self._is_refusing:
            _log.warning("session %d: %s; further refusals are not logged", self.handle, refusal)
        self._is_refusing = refusal is not None
        return refusal

    def _check(self, event: session_pb2.SessionEvent) -> None:
        """Raise an error if the event can never be sent."""
        if self._failure is not None:
            raise self._failure
        event.session = self.handle
        event.event_seq = self._next_seq
        self._carrier.check(event)
        if self._offset and (shifted(event, self._offset) is None or passed_targets(event, self._offset)):
            raise InvalidInput(event.WhichOneof("event") or "event", "frames that are past", "frames still to come")

    def _send(self, event: session_pb2.SessionEvent) -> None:
        """Give an event its number and send it, now or once a server has the session. Raises if it never can be."""
        self._check(event)
        self._say(event)

    def _say(self, event: session_pb2.SessionEvent) -> None:
        if event.HasField("close"):
            self._repeating.finish()
        self._unanswered.add(event)
        self._next_seq += 1
        if self._is_attached:
            self._transmit(event)

    def _transmit(self, event: session_pb2.SessionEvent) -> None:
        self._said_to = max(self._said_to, event.event_seq)
        moved = shifted(event, self._offset)
        if moved is not None:
            self._carrier.send(moved)
