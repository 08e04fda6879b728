"""StepQuotas: owners' quotas of rows of denoising steps per second, and what they have used of them.

Steps are saved up for a second. Windows with frames that a client would run out of are charged but never wait, so an
owner may also overdraw by a second; its replans and clips wait until it has steps again. A window is charged when it is
started, before it waits for its turn, so that no more windows wait than there are steps for; if it is discarded before
its first step, the charge is given back.

A quota applies to all engines together: each counts its own use, reports the steps of the windows that begin, and is
told those of the others. Sessions on one engine alone may use all of it.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass
from math import isfinite

from motiongen_server.engine.types import Owner, StepsOf

_SAVED_S = 1.0
# From this many accounts on, those that are full again are dropped.
_MANY = 256


@dataclass(slots=True)
class _Account:
    owner: Owner
    left: float
    at: float

    def update(self, owner: Owner, now: float) -> None:
        """owner: with its current quota."""
        most = _SAVED_S * owner.steps_per_s
        self.left = min(most, self.left + max(0.0, now - self.at) * owner.steps_per_s)
        self.owner, self.at = owner, max(self.at, now)


class StepQuotas:
    """What each owner that has a quota may still use. Time is passed as an argument."""

    def __init__(self) -> None:
        self._accounts: dict[str, _Account] = {}
        self._taken: Counter[Owner] = Counter()  # since the last report
        self._elsewhere: deque[StepsOf] = deque()

    @property
    def num_accounts(self) -> int:
        """The number of owners whose steps are counted."""
        return len(self._accounts)

    def note_elsewhere(self, taken: StepsOf) -> None:
        """Other engines' windows have taken these steps. May be called from any thread."""
        self._elsewhere.append(taken)

    def take_taken(self, now: float) -> StepsOf:
        """The steps of windows begun here since the last call, of owners with a quota. Must be called every round."""
        self._charge_elsewhere(now)
        taken = tuple(self._taken.items())
        self._taken.clear()
        return taken

    def charge(self, owner: Owner, steps: int, now: float) -> float:
        """Charge an owner for a window of this many steps. Returns what was charged.

        That is less than the steps if the owner already owes as much as it may.
        """
        if not isfinite(owner.steps_per_s):
            return 0.0
        account = self._account(owner, now)
        before = account.left
        account.left = max(before - steps, min(before, -_SAVED_S * owner.steps_per_s))
        return before - account.left

    def give_back(self, owner: Owner, charged: float) -> None:
        """A window for which this much was charged was discarded before its first step."""
        account = self._accounts.get(owner.name)
        if account is not None:  # else it was full and was dropped
            account.left += charged  # may exceed what can be saved up until the next update

    def note_begun(self, owner: Owner, steps: int) -> None:
        """A window of this many steps begins: report it to the other engines."""
        if isfinite(owner.steps_per_s):
            self._taken[owner] += steps

    def ready_at(self, owner: Owner, now: float) -> float:
        """When a window that can wait may begin: now, or when the owner has a step again."""
        if not isfinite(owner.steps_per_s):
            return now
        account = self._account(owner, now)
        return now if account.left > 0.0 else now + (1.0 - account.left) / owner.steps_per_s

    def _charge_elsewhere(self, now: float) -> None:
        """Charge what other engines reported, without a limit: else an owner on many engines could exceed its quota."""
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
        """Drop the accounts that are full again: they hold nothing that a new one would not."""
        for account in self._accounts.values():
            account.update(account.owner, now)
        self._accounts = {
            name: account
            for name, account in self._accounts.items()
            if account.left < _SAVED_S * account.owner.steps_per_s
        }
