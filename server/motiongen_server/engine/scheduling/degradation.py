"""Degradation: what sessions give up when the machine cannot keep up, least urgent class first, level by level.

Pure: time comes in as an argument. A class goes down while too many of its windows are late or the load is too high,
and up again only after it has been well for some time, so that it does not go up and down. Where it is known what all
who are there take, as much is given up at once as has to be, and no more. When nobody is left, those who come next are
served in full.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from motiongen_server.engine.scheduling.levels import Level
from motiongen_server.engine.types import Priority

# How many levels the classes below are ahead of a class: heroes give up their first level last.
_HEAD_START = {Priority.BATCH: 0, Priority.CROWD: 0, Priority.NEAR: 2, Priority.HERO: 4}
# Only these may be made to stand still, and may be closed after that.
EXPENDABLE = (Priority.BATCH, Priority.CROWD)


@dataclass(frozen=True, slots=True)
class Demand:
    """What all who are there would take of the machine. in_full: by class; kept: of that, what each level takes.

    elsewhere: what others take of it, whatever is given up here.
    """

    in_full: Mapping[Priority, float]
    kept: Sequence[float]
    elsewhere: float = 0.0

    def at(self, depth: Callable[[Priority], int]) -> float:
        """The share of the machine that is taken where each class is so many levels down."""
        return self.elsewhere + sum(share * self.kept[depth(priority)] for priority, share in self.in_full.items())

    def fits(self, share: float) -> bool:
        """Whether less than that share of the machine would be taken if nobody gave up anything."""
        return self.at(lambda _: 0) < share


@dataclass(frozen=True, slots=True)
class DegradationLimits:
    """When to go down and up. Shares are of 1.

    Down where the windows of miss_window_s were late by more than miss_share of the time that their frames play, or
    the load is above high_load, and that for pressed_s, since many sessions that open at once ask for more than they
    do later; not again within settle_s, since what a level saves shows only then. As far down at once as what is there
    takes to be below enough_load. Windows that were late at one moment count for all of miss_window_s: where the load
    is not high, and all that is there takes less than enough_load in full, lateness has to last for lasting_s.
    Up after well_s without either and with the load below low_load, and after half as long if the level before held;
    where it did not, twice as long, up to patience times. Where all that is there would be below fits_load in full, up
    after back_s, whatever was learned of a load that has gone; unless that was tried, and did not hold.
    least_busy: a machine that computes for less of the time is not what windows are late for, and nobody gets less.
    min_windows: fewer than so many windows say nothing about the share that is late.
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
    """On which level every class is. `shed` tells that the last level did not help."""

    def __init__(self, levels: tuple[Level, ...], now: float, limits: DegradationLimits | None = None) -> None:
        self._levels = levels
        self._limits = limits or DegradationLimits()
        # Every move there is, in the order in which they are made: so that a class goes down one level.
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
        self._spared: set[int] = set()  # of the moves that are made, those that hold a class of which nobody is there
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
        """Where a class is."""
        return self._levels[self.depth(priority)]

    def depth(self, priority: Priority) -> int:
        """How many levels down a class is."""
        made = enumerate(self._moves[: self._made])
        return max(
            (depth for index, (moved, depth) in made if moved is priority and index not in self._spared), default=0
        )

    def note_windows(self, now: float, windows: int, late: float) -> None:
        """So many windows were due. late: for how long their frames were not there, in the time that a window plays.

        Who waits for a window by a twentieth of that time misses a twentieth of its frames, not all of them.
        """
        if windows:
            self._noted.append((now, windows, late))
            self._windows += windows
            self._late += late

    @property
    def missed_share(self) -> float:
        """Of the frames of the windows of the last miss_window_s, those that were late; 0 where too few are known."""
        return self._late / self._windows if self._windows >= self._limits.min_windows else 0.0

    def update(
        self,
        now: float,
        load: float,
        present: Mapping[Priority, int],
        busy: float = 1.0,
        demand: Demand | None = None,
    ) -> Iterable[Priority]:
        """Go down, or up a level, if it is time; returns the classes that moved.

        load: share of the machine that is in use. present: sessions of each class; those without any are passed over.
        busy: share of the time in which anything was computed, however well its steps were filled. demand: of all who
        are there, None where that is not known.

        A class of which nobody is there holds no pose: whoever comes next is made frames, if at a lower level.
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
            self._forget_windows()  # what was late before says nothing about the level that comes
            return self._down(present, demand)
        fits = demand is not None and demand.fits(limits.fits_load) and self._trusts_asked
        if self._made and now - max(self._well_since, self._settled_at) >= (limits.back_s if fits else self._wait_s):
            self._settled_at = self._went_up_at = now
            self._went_up_by_asked = fits
            self._wait_s = max(limits.well_s, self._wait_s / 2)  # if this one holds, the next comes sooner
            return self._up(present, fits)
        return ()

    def _pressed_s(self, load: float, demand: Demand | None) -> float:
        """For how long windows may be late, or the load too high, before anybody gets less."""
        limits = self._limits
        is_enough = load <= limits.high_load and demand is not None and demand.fits(limits.enough_load)
        return limits.lasting_s if is_enough else limits.pressed_s

    def _forget(self, now: float) -> None:
        """Nobody is there: what was too much for the machine has gone."""
        self._made, self._wait_s, self._trusts_asked = 0, self._limits.well_s, True
        self._spared.clear()
        self._settled_at = self._unpressed_at = now
        self._forget_windows()

    def _forget_windows(self) -> None:
        self._noted.clear()
        self._windows, self._late = 0, 0.0

    def _learn_patience(self, now: float) -> None:
        """The last level up did not hold for long: wait longer before the next, and so stop going up and down."""
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
        """fits: all that is there would; then nobody of a class stands any longer, not only fewer."""
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
