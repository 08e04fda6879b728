"""NewestOwners: the current shares and quotas of owners, for sessions that were opened under earlier ones."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from motiongen_server.engine.open_sessions import OpenSessions
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Owner


class NewestOwners:
    """The latest values noted for an owner apply to all of its sessions, from their next windows on.

    `note` may be called from any thread, everything else from the engine's. An Open with an owner's earlier values may
    arrive after newer ones were noted. One that has newer values than were noted gets the noted ones until the newer
    ones are noted too, which happens at about the same time.
    """

    def __init__(self, admission: Admission, sessions: OpenSessions) -> None:
        self._admission = admission
        self._sessions = sessions
        self._heard: deque[Owner] = deque()
        self._newest: dict[str, Owner] = {}

    def note(self, owner: Owner) -> None:
        """From now on an owner has this share and quota."""
        self._heard.append(owner)

    def apply(self) -> None:
        """Update the sessions of the owners that were noted since the last call."""
        changed: dict[str, Owner] = {}
        while self._heard:
            owner = self._heard.popleft()
            changed[owner.name] = owner
        if changed:
            self._newest |= changed
            for state in self._sessions:
                self.renew(state)

    def renew(self, state: SessionState) -> None:
        """Give a session its owner's current values."""
        spec = state.spec
        newest = self._newest.get(spec.owner.name, spec.owner)
        if newest != spec.owner:
            state.spec = replace(spec, owner=newest)
            self._admission.change(spec, state.spec)  # never refused, since it asks for no more than before
