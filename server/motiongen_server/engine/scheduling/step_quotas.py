"""StepQuotas: owners that may have so many rows of denoising steps a second, and what they have had.

Steps are saved up for a second. Windows of frames that a client would run out of are charged and never wait, so an
owner may overdraw by a second too; its replans and clips wait until it has steps again.

A quota is that of all engines together: each counts for itself, tells what its windows took, and is told what those of
the others did. A session on one engine alone may use all of it.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from math import isfinite

from motiongen_server.engine.types import Owner, StepsOf

_SAVED_S = 1.0
# Accounts of owners that have not been heard of are looked for once there are so many.
_MANY = 256


@dataclass(slots=True)
class _Account:
    owner: Owner
    left: float
    at: float

    def update(self, owner: Owner, now: float) -> None:
        """owner: with the quota that it has by now."""
        most = _SAVED_S * owner.steps_per_s
        self.left = min(most, self.left + max(0.0, now - self.at) * owner.steps_per_s)
        self.owner, self.at = owner, now


class StepQuotas:
    """What each owner that has a quota may still have. Time comes in as an argument."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}
        self._taken: Counter[Owner] = Counter()  # since it was last told
        self._elsewhere: deque[StepsOf] = deque()

    @property
    def num_accounts(self) -> int:
        """Owners whose steps are kept count of."""
        return len(self._accounts)

    def note_elsewhere(self, taken: StepsOf) -> None:
        """Other engines' windows have taken so many steps. May be called from any thread."""
        self._elsewhere.append(taken)

    def take_taken(self, now: float) -> StepsOf:
        """What windows here took since the last call, of owners that have a quota. Called in every round."""
        self._charge_elsewhere(now)
        taken = tuple(self._taken.items())
        self._taken.clear()
        return taken

    def charge(self, owner: Owner, steps: int, now: float) -> None:
        """A window of so many steps begins for one of its sessions."""
        if isfinite(owner.steps_per_s):
            self._taken[owner] += steps
            account = self._account(owner, now)
            account.left = max(account.left - steps, min(account.left, -_SAVED_S * owner.steps_per_s))

    def ready_at(self, owner: Owner, now: float) -> float:
        """When a window that can wait may begin: now, or when the owner has a step again."""
        if not isfinite(owner.steps_per_s):
            return now
        account = self._account(owner, now)
        return now if account.left > 0.0 else now + (1.0 - account.left) / owner.steps_per_s

    def _charge_elsewhere(self, now: float) -> None:
        """In full, however much it is: else an owner at many engines would have so many seconds' worth for nothing."""
        while self._elsewhere:
            for owner, steps in self._elsewhere.popleft():
                self._account(owner, now).left -= steps

    def _account(self, owner: Owner, now: float) -> _Account:
        account = self._accounts.get(owner.name)
        if account is None:
            if len(self._accounts) >= _MANY:
                self._forget(now)
            account = self._accounts[owner.name] = _Account(owner, _SAVED_S * owner.steps_per_s, now)
        account.update(owner, now)
        return account

    def _forget(self, now: float) -> None:
        """Drop the accounts that are full again: they say nothing that a new one would not."""
        for account in self._accounts.values():
            account.update(account.owner, now)
        self._accounts = {
            name: account
            for name, account in self._accounts.items()
            if account.left < _SAVED_S * account.owner.steps_per_s
        }
