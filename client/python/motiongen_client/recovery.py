"""Recovery: how a session continues after the connection to its server was lost.

The stream calls `interrupt`, and `reattach` once there is another call. The session then resumes. If the server cannot
resume it, it is opened anew (`reopening`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from motiongen.v1 import session_pb2
from motiongen_client.backlog import Unanswered
from motiongen_client.backoff import Backoff
from motiongen_client.carrier import Carrier
from motiongen_client.errors import EventRefused, ProtocolViolation
from motiongen_client.reopening import Line, Reopening
from motiongen_client.types import Catalog, Opened

_WORTH_WAITING = frozenset({"RESOURCE_EXHAUSTED", "UNAVAILABLE"})


class Recovery(Reopening):
    """The part of a `Session` that returns to a server, or moves to another."""

    def __init__(self, handle: int, carrier: Carrier, catalog: Catalog, clock: Callable[[], float]) -> None:
        super().__init__(handle, carrier, catalog, clock)
        self._num_resumes = 0
        self.asked: set[str] = set()  # names of the servers that had no room for it since it last waited
        self._patience = Backoff()  # reset when frames come: servers may open a session and close it at once, for ever

    # ---- for the stream

    def interrupt(self) -> None:
        """The connection is lost; `reattach` or `fail` follows."""
        self._repeating.stop()
        if self._line is not Line.OPENING:
            self._line = Line.LOST
            self._changed.set()  # callers that wait for an answer learn that none will come

    def reattach(self, catalog: Catalog) -> None:
        """There is a new call, to a server with this catalogue: continue there."""
        self._catalog = catalog
        if self._line is Line.OPENING:
            self._send_unanswered()
        elif self._token:
            self._resume()
        else:
            self._reopen(self._reason or "the server does not resume sessions")

    @property
    def is_away(self) -> bool:
        """Whether its connection was lost and the session has not continued yet."""
        return self._line in (Line.LOST, Line.RESUMING, Line.REOPENING)

    @property
    def is_waiting(self) -> bool:
        """Whether it is open, but no server is being asked to continue it."""
        return self._line is Line.LOST and self._failure is None

    def wait_for_room(self, refusal: EventRefused) -> None:
        """Neither the server nor another has free capacity: ask again after the time that the refusal states."""
        self.asked.clear()
        self._later(self._resume if self._token else self._reopen_again, refusal.retry_after_s or 0.0)

    def move(self, handle: int, carrier: Carrier, catalog: Catalog, *, now: bool) -> None:
        """Move to another stream, under this handle. now: that stream has a call, so ask its server at once."""
        self.handle, self._carrier = handle, carrier
        held, self._unanswered = self._unanswered.take_all(), Unanswered(carrier.backlog)
        for event in held:
            event.session = handle
            self._unanswered.add(event)
        if now:
            self.reattach(catalog)

    # ---- sending

    @property
    def _is_attached(self) -> bool:
        return self._line in (Line.OPENING, Line.OPEN) and not self._repeating.is_under_way

    def _resume(self) -> None:
        self._line = Line.RESUMING
        self._attempt += 1
        point = session_pb2.ResumePoint(
            next_frame=self.playback.received_to - self._offset,
            plan=self.playback.plan,
            answered_seq=self._answered_seq,
            attempt=self._attempt,
            playhead=max(self.playback.playhead - self._offset, 0),
            committed_to=max(self.playback.committed_to - self._offset, 0),
        )
        self._send_opening(session_pb2.OpenSession(resume_token=self._token, resume_point=point))

    # ---- updates

    def _hear_reopened(self, opened: Opened, token: str) -> None:
        """The session continues: resumed, or opened anew."""
        if self._line is Line.RESUMING:
            self._line = Line.OPEN
            self._num_resumes += 1
            self._reached.begin_replay()
            self._send_unanswered()
        elif self._line is Line.REOPENING:
            self._reached.end_replay()
            self._go_on_anew(opened)
        else:
            raise ProtocolViolation("a session was opened that had not been asked for")
        self._token = token
        self.asked.clear()
        self._carrier.report_soon()

    def _hear_refused_opening(self, refusal: EventRefused) -> None:
        if self._line is Line.OPENING:
            self.fail(refusal)
        elif refusal.code in _WORTH_WAITING:
            self._line = Line.LOST
            if not self._carrier.move_elsewhere(self.handle, refusal):
                self.wait_for_room(refusal)
        elif self._line is Line.RESUMING:
            self._reopen(f"the server did not keep it ({refusal.reason})")
        else:
            self.fail(refusal)

    def _lose(self, reason: str) -> None:
        """The server is leaving or has lost the session: resume it elsewhere, or open it anew."""
        self._repeating.stop()
        self._line, self._reason = Line.LOST, reason
        self._changed.set()
        if not self.is_durable:
            self._token = ""
        if not self._carrier.draining:  # otherwise this call ends soon, and the next reattaches
            self._later(self._resume if self._token else self._reopen_again, 0.0)

    def _reopen_again(self) -> None:
        self._reopen(self._reason)

    def _later(self, act: Callable[[], None], at_least_s: float) -> None:
        """Make another attempt after a delay, unless the call or the session's state has changed by then.

        Without a call there is nobody to ask; `reattach` makes the attempt once there is one.
        """
        call = self._carrier.call_number

        def due() -> None:
            is_same_call = self._carrier.is_connected and self._carrier.call_number == call
            if self._line is Line.LOST and self._failure is None and is_same_call:
                act()

        asyncio.get_running_loop().call_later(self._patience.next_s(at_least_s), due)
