"""WindowRates: how many windows per second a session of each class has asked for lately, edits included."""

from __future__ import annotations

from collections.abc import Mapping

from motiongen_server.engine.types import Priority

# What was seen counts half as much after this time.
_HALF_LIFE_S = 10.0
# The replans per second expected of a session before any were seen. This expectation weighs as much as having watched
# one session for _EXPECTED_S.
EXPECTED_HZ = {Priority.HERO: 1.0, Priority.NEAR: 0.3, Priority.CROWD: 0.2, Priority.BATCH: 0.1}
_EXPECTED_S = 20.0


class WindowRates:
    """By class: the rate of merely playing on, plus one window per replan, which replaces about a whole one.

    Replans are counted per second of session time, so that many sessions that come at once do not pass for sessions
    that ask for little. What sessions of a class did is remembered after they have gone, as it is expected of the next
    ones.
    """

    def __init__(self, playing_hz: float) -> None:
        """playing_hz: windows per second of a session that is never edited."""
        self._playing_hz = playing_hz
        self._replans = dict.fromkeys(Priority, 0.0)
        self._watched_s = dict.fromkeys(Priority, 0.0)
        self._begun = dict.fromkeys(Priority, 0.0)

    def __getitem__(self, priority: Priority) -> float:
        """Windows per second of one session."""
        replans = self._replans[priority] + EXPECTED_HZ[priority] * _EXPECTED_S
        return self._playing_hz + replans / (self._watched_s[priority] + _EXPECTED_S)

    def note_replan(self, priority: Priority, share: float = 1.0) -> None:
        """A window was begun that changes what a session would show.

        share: of a full window's steps; negative for a window that was discarded.
        """
        self._begun[priority] += share

    def update(self, elapsed_s: float, present: Mapping[Priority, int]) -> None:
        """Include what was begun in the last elapsed_s. present: sessions of each class."""
        for priority, sessions in present.items():
            if sessions > 0 and elapsed_s > 0:
                kept = 0.5 ** (elapsed_s / _HALF_LIFE_S)
                self._replans[priority] = max(0.0, kept * self._replans[priority] + self._begun[priority])
                self._watched_s[priority] = kept * self._watched_s[priority] + sessions * elapsed_s
        self._begun = dict.fromkeys(Priority, 0.0)
