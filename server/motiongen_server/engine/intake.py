"""Intake: what may come in, and how many at once: places for sessions, room for events."""

from __future__ import annotations

from motiongen_server.engine.mailbox import pending_refusal
from motiongen_server.engine.ports import Inbox
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.types import Close, Event, Open, Outcome


class Intake:
    """Takes events from any thread, up to where the engine's thread finds them: in `mailbox`.

    most_pending: how many events may wait; said in refusals.
    """

    def __init__(self, admission: Admission, mailbox: Inbox, most_pending: int) -> None:
        self._admission = admission
        self._mailbox = mailbox
        self._most_pending = most_pending

    def submit(self, event: Event) -> Outcome | None:
        """Take an event, and for an Open hold a place. A refusal where there is no room."""
        if isinstance(event, Open):
            refusal = self._admission.reserve(event.spec, event.event_seq)
            if refusal is not None:
                return refusal
        elif isinstance(event, Close):
            self._admission.release(event.session)  # its place can be taken at once
        if self._mailbox.put(event):
            return None
        if isinstance(event, Open):
            self._admission.release(event.session, event.spec)
        return pending_refusal(event, self._most_pending)
