"""Searches for the greatest number that passes, by doubling and bisection."""

from __future__ import annotations

from dataclasses import dataclass, field

_MOST_CHARACTERS = 1_000_000


@dataclass
class Bracket:
    """The state of the search: `most` passed, `too_many` failed (None: no failing number is known).

    The search ends when the two are within `tolerance` (of `most`) of each other.
    """

    start: int
    tolerance: float = 0.05
    most: int = 0
    too_many: int | None = None
    _served: list[int] = field(default_factory=list)

    def next(self) -> int | None:
        """The next number to try; None when the search is over."""
        if self.too_many is None:
            return min(self.most * 2 or self.start, _MOST_CHARACTERS) if self.most < _MOST_CHARACTERS else None
        if self.too_many - self.most <= max(1, self.tolerance * self.most):
            return None
        return self.too_many // 2 if self.most == 0 else (self.most + self.too_many) // 2

    def note(self, characters: int, passed: bool) -> None:
        """Note a result. A number that passed once and then fails counts as failed, and so does every larger one."""
        if passed:
            self._served.append(characters)
            self.most = max(self.most, characters)
        else:
            self.too_many = characters if self.too_many is None else min(self.too_many, characters)
            self._served = [served for served in self._served if served < self.too_many]
            self.most = max(self._served, default=0)
