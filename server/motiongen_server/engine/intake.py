"""Intake: what comes in, and how many at once may: places for sessions, room for events; news of owners."""

from __future__ import annotations

from motiongen_server.engine.mailbox import pending_refusal
from motiongen_server.engine.newest_owners import NewestOwners
from motiongen_server.engine.ports import Inbox
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.types import Close, Event, Open, Outcome, Owner, StepsOf


class Intake:
    """Takes what comes from any thread, up to where the engine's thread finds it: in `mailbox`, `quotas` and `owners`.

    most_pending: how many events may wait; said in refusals.
    """

    def __init__(
        self, admission: Admission, mailbox: Inbox, most_pending: int, quotas: StepQuotas, owners: NewestOwners
    ) -> None:
        self._admission = admission
        self._mailbox = mailbox
        self._most_pending = most_pending
        self._quotas = quotas
        self._owners = owners

    def note_owner(self, owner: Owner) -> None:
        """An owner has this share and quota from now on, for the sessions that it has, too."""
        self._owners.note(owner)

    def note_steps_elsewhere(self, taken: StepsOf) -> None:
        """Other engines have done so many steps for owners that have a quota."""
        self._quotas.note_elsewhere(taken)

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
