"""Intake: takes events and changes of owners from any thread, and refuses events for which there is no room."""

from __future__ import annotations

from motiongen_server.engine.mailbox import pending_refusal
from motiongen_server.engine.newest_owners import NewestOwners
from motiongen_server.engine.ports import Inbox
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.step_quotas import StepQuotas
from motiongen_server.engine.types import Close, Event, Open, Outcome, Owner, StepsOf


class Intake:
    """Passes what comes from any thread on to where the engine's thread reads it: `mailbox`, `quotas` and `owners`.

    most_pending: how many events of a session may wait; refusals state it.
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
        """From now on an owner has this share and quota, also for the sessions that it has already."""
        self._owners.note(owner)

    def note_steps_elsewhere(self, taken: StepsOf) -> None:
        """Other engines have done this many steps for owners that have a quota."""
        self._quotas.note_elsewhere(taken)

    def submit(self, event: Event) -> Outcome | None:
        """Take an event; for an Open, also reserve a place. Returns a refusal if there is no room."""
        if isinstance(event, Open):
            refusal = self._admission.reserve(event.spec, event.event_seq)
            if refusal is not None:
                return refusal
        elif isinstance(event, Close):
            self._admission.release(event.session)  # so that another session can have its place at once
        if self._mailbox.put(event):
            return None
        if isinstance(event, Open):
            self._admission.release(event.session, event.spec)
        return pending_refusal(event, self._most_pending)
