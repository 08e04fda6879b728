"""WindowRates: how many windows a second a session of each class asks for, edits included, as was seen of late."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from motiongen_server.engine.types import Priority

_LEARNED_OVER_S = 5.0


class WindowRates:
    """By class; at least what playing on alone takes, which is also what holds until something else was seen.

    What sessions of a class did is kept when they have gone: it is what the next ones are expected to do.
    """

    def __init__(self, playing_hz: float) -> None:
        """playing_hz: windows a second of a session that is never edited."""
        self._playing_hz = playing_hz
        self._seen_hz = dict.fromkeys(Priority, playing_hz)
        self._finished: Counter[Priority] = Counter()

    def __getitem__(self, priority: Priority) -> float:
        """Windows a second of one session."""
        return max(self._playing_hz, self._seen_hz[priority])

    def note(self, priority: Priority) -> None:
        """A session's window was finished."""
        self._finished[priority] += 1

    def update(self, elapsed_s: float, present: Mapping[Priority, int]) -> None:
        """Take in what was finished in the last elapsed_s; present: sessions of each class."""
        weight = min(1.0, elapsed_s / _LEARNED_OVER_S)
        for priority, sessions in present.items():
            if sessions > 0 and elapsed_s > 0:
                each_hz = self._finished[priority] / (sessions * elapsed_s)
                self._seen_hz[priority] += weight * (each_hz - self._seen_hz[priority])
        self._finished.clear()
