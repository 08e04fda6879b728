"""Degradation: what sessions give up when the machine cannot keep up, least urgent class first, level by level.

Pure: time is passed as an argument. A class goes down a level while too many of its windows are late or the load is too
high, and up again only after it has been well for some time, so that it does not oscillate. If the demand of all
sessions is known, as many levels are given up at once as necessary, and no more. When no sessions are left, the next
ones are served in full.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from motiongen_server.engine.scheduling.levels import Level
from motiongen_server.engine.types import Priority

# How many levels a class lags behind BATCH and CROWD: heroes give up their first level last.
_HEAD_START = {Priority.BATCH: 0, Priority.CROWD: 0, Priority.NEAR: 2, Priority.HERO: 4}
# Only these classes may be held and, after that, closed.
EXPENDABLE = (Priority.BATCH, Priority.CROWD)


@dataclass(frozen=True, slots=True)
class Demand:
    """What all sessions present would take of the machine. in_full: per class; kept: the share left on each level.

    elsewhere: what others take of the machine, whatever is given up here.
    """

    in_full: Mapping[Priority, float]
    kept: Sequence[float]
    elsewhere: float = 0.0

    def at(self, depth: Callable[[Priority], int]) -> float:
        """The share of the machine that is taken if each class is at this depth, in levels."""
        return self.elsewhere + sum(share * self.kept[depth(priority)] for priority, share in self.in_full.items())

    def fits(self, share: float) -> bool:
        """Whether less than this share of the machine would be taken if nobody gave up anything."""
        return self.at(lambda _: 0) < share


@dataclass(frozen=True, slots=True)
class DegradationLimits:
    """When to go down and up. Shares are of 1.

    Down: if the windows of the last miss_window_s were late by more than miss_share of the time that their frames play,
    or the load is above high_load. Either must last for pressed_s, since many sessions that open at once ask for more
    than they do later; and at least settle_s after the last move, since only then it shows what a level saves. If the
    demand is known, as far down at once as brings it below enough_load. Windows that were late at one moment count for
    all of miss_window_s; so where the load is not high and the full demand is below enough_load, lateness must last for
    lasting_s.

    Up: after well_s without either and with the load below low_load. After half as long if the previous level up held;
    if it did not, after twice as long, up to patience times well_s. If the full demand is below fits_load, after
    back_s, whatever was learned from an earlier load, unless that was tried and did not hold.

    least_busy: if the machine computes for less than this share of the time, it is not the reason for late windows, and
    nobody gets less. min_windows: fewer windows than this say nothing about the share that is late.
    """

    miss_share: float = 0.01
    miss_window_s: float = 2.0
    high_load: float = 0.95
    low_load: float = 0.8
    fits_load: float = 0.7
    enough_load: float = 0.9
    least_busy: float = 0.5
    pressed_s: float = 1.0
    lasting_s: float = 2.5
    settle_s: float = 2.0
    well_s: float = 10.0
    back_s: float = 5.0
    patience: int = 8
    min_windows: int = 10


class Degradation:
    """The level of every class. `shed`: the last level did not help."""

    def __init__(self, levels: tuple[Level, ...], now: float, limits: DegradationLimits | None = None) -> None:
        self._levels = levels
        self._limits = limits or DegradationLimits()
        # All moves in the order in which they are made. A move takes one class down one level.
        first_hold = next((depth for depth, level in enumerate(levels) if level.hold), len(levels))
        self._moves = sorted(
            (
                (priority, depth)
                for priority in Priority
                for depth in range(1, len(levels))
                if priority in EXPENDABLE or not levels[depth].hold
            ),
            key=lambda move: (min(move[1], first_hold) + _HEAD_START[move[0]], -move[0], move[1]),
        )
        self._made = 0
        self._spared: set[int] = set()  # moves that were made but do not apply: holds of a class without sessions
        self._noted: deque[tuple[float, int, float]] = deque()
        self._windows, self._late = 0, 0.0
        self._settled_at = now
        self._well_since = now
        self._unpressed_at = now
        self._went_up_at = -math.inf
        self._wait_s = self._limits.well_s
        self._trusts_asked, self._went_up_by_asked = True, False
        self.shed = False

    def level(self, priority: Priority) -> Level:
        """The level of a class."""
        return self._levels[self.depth(priority)]

    def depth(self, priority: Priority) -> int:
        """How many levels down a class is."""
        made = enumerate(self._moves[: self._made])
        return max(
            (depth for index, (moved, depth) in made if moved is priority and index not in self._spared), default=0
        )

    def note_windows(self, now: float, windows: int, late: float) -> None:
        """Windows were due. late: how long their frames were missing, in units of the time that a window plays.

        A client that waits for a window for a twentieth of that time misses a twentieth of its frames, not all of them.
        """
        if windows:
            self._noted.append((now, windows, late))
            self._windows += windows
            self._late += late

    @property
    def missed_share(self) -> float:
        """The share of frames that were late in the windows of the last miss_window_s; 0 if there were too few."""
        return self._late / self._windows if self._windows >= self._limits.min_windows else 0.0

    def update(
        self,
        now: float,
        load: float,
        present: Mapping[Priority, int],
        busy: float = 1.0,
        demand: Demand | None = None,
    ) -> Iterable[Priority]:
        """Go down, or up a level, if it is time. Returns the classes that moved.

        load: share of the machine in use. present: sessions of each class; classes without any are passed over. busy:
        share of the time in which anything was computed, however full the steps were. demand: of all sessions present,
        None if not known.

        A class without sessions is not held: the next session that opens in it gets frames, though at a lower level.
        """
        moved = self._move(now, load, present, busy, demand)
        self._spared |= {
            index
            for index, (priority, depth) in enumerate(self._moves[: self._made])
            if self._levels[depth].hold and not present.get(priority, 0)
        }
        return moved

    def _move(
        self, now: float, load: float, present: Mapping[Priority, int], busy: float, demand: Demand | None
    ) -> Iterable[Priority]:
        limits = self._limits
        while self._noted and self._noted[0][0] < now - limits.miss_window_s:
            _, windows, late_windows = self._noted.popleft()
            self._windows -= windows
            self._late -= late_windows
        late = self.missed_share > limits.miss_share and busy >= limits.least_busy
        pressed = late or load > limits.high_load
        settled = now - self._settled_at >= limits.settle_s
        if settled and not pressed:
            self._unpressed_at = now
        if pressed or load > limits.low_load:
            self._well_since = now
        self.shed = False
        if not any(present.values()):
            self._forget(now)
            return ()
        if pressed and settled and now - self._unpressed_at >= self._pressed_s(load, demand):
            self._learn_patience(now)
            self._settled_at = now
            self._forget_windows()  # earlier lateness says nothing about the next level
            return self._down(present, demand)
        fits = demand is not None and demand.fits(limits.fits_load) and self._trusts_asked
        if self._made and now - max(self._well_since, self._settled_at) >= (limits.back_s if fits else self._wait_s):
            self._settled_at = self._went_up_at = now
            self._went_up_by_asked = fits
            self._wait_s = max(limits.well_s, self._wait_s / 2)  # if this level holds, the next one up comes sooner
            return self._up(present, fits)
        return ()

    def _pressed_s(self, load: float, demand: Demand | None) -> float:
        """How long windows must be late, or the load too high, before anybody gets less."""
        limits = self._limits
        is_enough = load <= limits.high_load and demand is not None and demand.fits(limits.enough_load)
        return limits.lasting_s if is_enough else limits.pressed_s

    def _forget(self, now: float) -> None:
        """No sessions are left, so what was too much for the machine has gone."""
        self._made, self._wait_s, self._trusts_asked = 0, self._limits.well_s, True
        self._spared.clear()
        self._settled_at = self._unpressed_at = now
        self._forget_windows()

    def _forget_windows(self) -> None:
        self._noted.clear()
        self._windows, self._late = 0, 0.0

    def _learn_patience(self, now: float) -> None:
        """If the last level up did not hold for long, wait longer before the next, so as not to oscillate."""
        limits = self._limits
        if now - self._went_up_at < limits.well_s:
            self._wait_s = min(4 * self._wait_s, limits.patience * limits.well_s)
            self._trusts_asked &= not self._went_up_by_asked
        elif now - self._went_up_at > limits.patience * limits.well_s:
            self._wait_s, self._trusts_asked = limits.well_s, True

    def _down(self, present: Mapping[Priority, int], demand: Demand | None) -> Iterable[Priority]:
        moved: dict[Priority, None] = {}
        for index in (*sorted(self._spared), *range(self._made, len(self._moves))):
            priority = self._moves[index][0]
            if present.get(priority, 0):
                self._made = max(self._made, index + 1)
                self._spared.discard(index)
                moved[priority] = None
                if demand is None or demand.at(self.depth) <= self._limits.enough_load:
                    break
        self.shed = not moved and any(present.get(priority, 0) for priority in EXPENDABLE)
        return tuple(moved)

    def _up(self, present: Mapping[Priority, int], fits: bool) -> Iterable[Priority]:
        """fits: the full demand does; then all holds of a class end at once rather than one level."""
        moved: Priority | None = None
        while self._made:
            priority, depth = self._moves[self._made - 1]
            if moved is not None and not (fits and priority is moved and self._levels[depth].hold):
                break
            self._made -= 1
            if self._made in self._spared:
                self._spared.discard(self._made)
            elif present.get(priority, 0):
                moved = priority
        return () if moved is None else (moved,)
