"""NewestOwners: shares and quotas as they are by now, of owners whose sessions were opened with others."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from motiongen_server.engine.open_sessions import OpenSessions
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Owner


class NewestOwners:
    """What was heard last of an owner holds for all of its sessions, from their next windows on.

    `note` may be called from any thread, all else from the engine's. An open with an earlier owner may come after that
    was heard; one with a newer owner than was heard keeps it only once that is heard too, which is told with it.
    """

    def __init__(self, admission: Admission, sessions: OpenSessions) -> None:
        self._admission = admission
        self._sessions = sessions
        self._heard: deque[Owner] = deque()
        self._newest: dict[str, Owner] = {}

    def note(self, owner: Owner) -> None:
        """An owner has this share and quota from now on."""
        self._heard.append(owner)

    def apply(self) -> None:
        """Give the sessions of those that were heard of what their owners have by now."""
        changed: dict[str, Owner] = {}
        while self._heard:
            owner = self._heard.popleft()
            changed[owner.name] = owner
        if changed:
            self._newest |= changed
            for state in self._sessions:
                self.renew(state)

    def renew(self, state: SessionState) -> None:
        """Give a session what its owner has by now."""
        spec = state.spec
        newest = self._newest.get(spec.owner.name, spec.owner)
        if newest != spec.owner:
            state.spec = replace(spec, owner=newest)
            self._admission.change(spec, state.spec)  # which asks for no more than before, and is not refused
