"""CostTable: seconds of preparing windows, of a denoising step, and of decoding, by how much is in one call.

Filled by a profile at start-up and tracked from then on. Sizes are counted in buckets; what a bucket costs is a running
mean of what was measured there. The curve over all buckets is made from those means so that more never costs less.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

_LEARNING_RATE = 0.125
# How fast what one size costs beside the others follows what is measured.
_SHAPE_RATE = 1 / 128
# The pace is of about so many calls, or of so long, where that is fewer; never of fewer than the least. By processor
# time it is of more: nobody takes that away, and where sessions open, calls are dear for some seconds only. Not of many
# more: calls become dearer, or cheaper, by what else is at work, while it is decided who is let in.
_PACE_CALLS, _LEAST_PACE_CALLS = 32, 8
_PACE_S = 2.0
_LONGER = 3
# One hiccup must not pass for the new normal: a measurement counts as at most so many times what was expected. What it
# took beyond that counts with the calls that follow, up to as long as a quota of processor time lets a process stand.
_MOST_SURPRISE = 4.0
_MOST_CARRIED_S = 0.1
_REFRESH_EVERY = 8
_LEAST_S = 1e-7
_MOST_WEIGHT = 32.0
# The engine's own time for a window is a mean over those of so long, and over so many at least: beside a GPU that many
# come and go in a fifth of a second, and would tell of a single wave. What it took too long counts with the windows
# that follow as what so many take, at most. What was measured before anybody came counts as no more windows than that:
# where it was wrong, those who come at once are to show it.
_OWN_S, _OWN_WINDOWS, _OWN_CARRIED, _OWN_MEASURED = 1.0, 128, 32, 32
_LEAST_OWN_S = 1e-5


def _grid(most: int) -> tuple[int, ...]:
    """1, 2, ... 8, and from there on four sizes to every doubling."""
    sizes = [*range(1, 8)]
    octave = 8
    while octave <= most:
        sizes += [octave + octave * quarter // 4 for quarter in range(4)]
        octave *= 2
    return tuple(sizes)


SIZES = _grid(1 << 14)


def bucket(size: int) -> int:
    """The size as which so many rows, evaluations or jobs are counted: the least of SIZES that holds them."""
    return SIZES[min(bisect_left(SIZES, size), len(SIZES) - 1)]


@dataclass(slots=True)
class Pace:
    """How slow the device is of late: what calls took, of what these sizes take else.

    A neighbour that takes the cores, or a quota that is used up, slows calls of every kind and size. The pace is a
    ratio of sums. A mean of ratios would be too great where calls are uneven, as those are on the way of which the
    processor is taken away; and of one kind of call alone it would be known late, where there are few of them. longer:
    looks back so many times further.

    by_size: a call counts by how much is in it. One that finds the caches taken by others costs a millisecond or two
    more, which is much of a small call and little of a large one: prices are of large ones, and have to follow these.
    """

    longer: int = 1
    by_size: bool = False
    value: float = 1.0
    _spent_s: float = 0.0
    _usual_s: float = 0.0
    _carried_s: float = 0.0

    def observe(self, size: int, usual_s: float, seconds: float) -> float:
        """Take in what a call took that usually takes usual_s. Returns what it counts as, of what was expected."""
        weight = size if self.by_size else 1
        expected_s = usual_s * self.value
        whole_s = seconds + self._carried_s
        ratio = min(whole_s / expected_s, _MOST_SURPRISE)
        self._carried_s = min(whole_s - ratio * expected_s, _MOST_CARRIED_S)
        if not self._usual_s:
            self._spent_s = self._usual_s = self.longer * _PACE_CALLS * weight * usual_s
        gone = min(1.0 / _LEAST_PACE_CALLS, max(1.0 / _PACE_CALLS, seconds / _PACE_S))
        kept = 1.0 - gone / self.longer
        self._spent_s = kept * self._spent_s + weight * ratio * expected_s
        self._usual_s = kept * self._usual_s + weight * usual_s
        self.value = self._spent_s / self._usual_s
        return ratio


@dataclass(slots=True)
class CallCosts:
    """What one kind of call costs by its size. assumed_s: of any size, before anything was measured.

    deviation: the mean distance of a measurement from what was expected, as a share of it. pace: of the device, for all
    its kinds of calls; spent: the same by the processor time that calls took, where that is told, else None. Who stands
    still because a quota is used up is late, but takes nothing of it.
    """

    assumed_s: float
    pace: Pace = field(default_factory=Pace)
    spent: Pace | None = None
    deviation: float = 0.0
    _means: dict[int, float] = field(default_factory=dict)
    _weights: dict[int, float] = field(default_factory=dict)
    _curve: list[float] = field(default_factory=list)
    _efficient: dict[tuple[int, float], int] = field(default_factory=dict)
    _unread: int = 0

    def begin(self, size: int, seconds: float) -> None:
        """What a call of this size takes, as a profile has found: it is taken as it is."""
        index = bisect_left(SIZES, size)
        self._means[index], self._weights[index] = max(seconds / self.pace.value, _LEAST_S), 1.0
        self._forget_curve()

    def observe(self, size: int, seconds: float, spent_s: float | None = None) -> None:
        """Take in what a call of this size took. spent_s: of the processor, where that is told; None: all of it."""
        index = bisect_left(SIZES, size)
        mean = self._means.get(index)
        if mean is None:
            mean = self._first_mean(index, size, seconds)
        if mean is None:
            self.begin(size, seconds)
            return
        ratio = self.pace.observe(size, mean, seconds)
        if self.spent is not None:
            self.spent.observe(size, mean, seconds if spent_s is None else spent_s)
        self.deviation += _LEARNING_RATE * (abs(ratio - 1.0) - self.deviation)
        self._means[index] = max(mean + _SHAPE_RATE * (ratio - 1.0) * mean, _LEAST_S)
        self._weights[index] = min(self._weights[index] + 1.0, _MOST_WEIGHT)
        self._unread += 1
        if self._unread >= _REFRESH_EVERY:
            self._forget_curve()

    def _first_mean(self, index: int, size: int, seconds: float) -> float | None:
        """What a size begins with that was never seen; None: with what this first call of it took.

        One measurement says little: between others it begins with what these cost. Smaller ones than all that were seen
        may cost less than the least of them, and larger ones less than in proportion; a call that took more may just
        have stood still, and nobody would try that size again, or would learn by it what others cost.
        """
        if not self._means:
            return None
        usual_s = self._usual_s(size)
        if not min(self._means) < index < max(self._means) and seconds <= self.pace.value * usual_s:
            return None
        self._weights[index] = 0.0
        return usual_s

    def _forget_curve(self) -> None:
        self._curve, self._unread = [], 0
        self._efficient.clear()

    def seconds(self, size: int) -> float:
        """What a call of this size is expected to take; it never falls as the size rises. 0 for size 0."""
        return self.pace.value * self._usual_s(size) if self._means else self._assumed_s(size)

    def each_s(self, size: int) -> float:
        """The share of one in a call of this size."""
        return self.seconds(size) / max(1, size)

    def spent_each_s(self, size: int) -> float:
        """What one in a call of this size is expected to take of the processor; as `each_s` where that is not told."""
        if self.spent is None or not self._means:
            return self.each_s(size)
        return self.spent.value * self._usual_s(size) / max(1, size)

    def _assumed_s(self, size: int) -> float:
        return self.assumed_s if size > 0 else 0.0

    def _usual_s(self, size: int) -> float:
        if size <= 0:
            return 0.0
        if not self._curve:
            self._curve = _monotone_curve(self._means, self._weights)
        index = bisect_left(SIZES, size)
        return self._curve[index] if index < len(self._curve) else self._curve[-1] * size / SIZES[-1]

    def largest_within(self, seconds: float) -> int:
        """The greatest bucket that is expected to take no longer than this; 0 where none is."""
        if not self._means:
            return SIZES[-1] if self.assumed_s <= seconds else 0
        self.seconds(1)  # makes the curve
        index = bisect_right(self._curve, seconds, key=lambda usual_s: self.pace.value * usual_s)
        return SIZES[index - 1] if index else 0

    def efficient_from(self, most: int, waste: float) -> int:
        """The least bucket in which one costs no more than `waste` times what it costs in a call of size `most`."""
        self.seconds(1)
        key = (most, waste)
        if key not in self._efficient:
            limit_s = waste * self.each_s(most)
            self._efficient[key] = next((size for size in SIZES if self.each_s(size) <= limit_s), most)
        return self._efficient[key]


def _monotone_curve(means: dict[int, float], weights: dict[int, float]) -> list[float]:
    """Seconds for every size of the grid: the means made monotone, straight lines between, in proportion beyond.

    Means that fall as the size rises are replaced by their weighted mean (pool adjacent violators), so that a size
    that was seen rarely yields to its neighbours.
    """
    pools: list[tuple[float, float, list[int]]] = []
    for index in sorted(means):
        value, weight, members = means[index], weights[index], [index]
        while pools and pools[-1][0] > value:
            other_value, other_weight, other_members = pools.pop()
            value = (value * weight + other_value * other_weight) / (weight + other_weight)
            weight, members = weight + other_weight, other_members + members
        pools.append((value, weight, members))
    known = [(index, value) for value, _, members in pools for index in members]
    curve = [known[0][1]] * (known[0][0] + 1)
    for (low, low_s), (high, high_s) in itertools.pairwise(known):
        slope = (high_s - low_s) / (SIZES[high] - SIZES[low])
        # The last point is taken as it is: a rounding error must not make the curve fall there.
        curve += [min(low_s + slope * (SIZES[index] - SIZES[low]), high_s) for index in range(low + 1, high)]
        curve.append(high_s)
    last, last_s = known[-1]
    curve += [last_s * SIZES[index] / SIZES[last] for index in range(last + 1, len(SIZES))]
    return curve


@dataclass(slots=True)
class CostTable:
    """Seconds by size of call. prepare, decode: by windows. step: by evaluations of the denoiser, over all rows.

    own_each_s: what the engine itself does for a window, between calls.
    """

    prepare: CallCosts
    step: CallCosts
    decode: CallCosts
    own_each_s: float = 0.0
    _own_seen: int = 0
    _own_weight: float = float(_OWN_WINDOWS)
    _own_carried_s: float = 0.0

    @classmethod
    def assumed(cls, step_s: float) -> CostTable:
        """A table without measurements: a step costs step_s, the rest nothing."""
        pace = Pace()
        return cls(CallCosts(0.0, pace), CallCosts(step_s, pace), CallCosts(0.0, pace))

    def follow_processor(self) -> None:
        """From now on calls are told with the processor time that they took."""
        spent = Pace(longer=_LONGER, by_size=True)
        for costs in (self.prepare, self.step, self.decode):
            costs.spent = spent

    def begin_own(self, each_s: float) -> None:
        """What the engine itself does for a window, as was measured: it is taken as it is until windows come."""
        self.own_each_s, self._own_seen, self._own_weight = each_s, _OWN_WINDOWS, float(_OWN_MEASURED)

    def observe_own(self, windows: int, seconds: float, elapsed_s: float = math.inf) -> None:
        """The engine took so long between calls, from the end of some windows to the end of these.

        elapsed_s: between those ends, calls and idling too. What it took beyond some times what was expected counts
        with the windows that follow, as far as that is no more than some others take: who stands still for a second,
        as while something else is loaded, is not slower from then on.
        """
        whole_s, expected_s = seconds + self._own_carried_s, windows * max(self.own_each_s, _LEAST_OWN_S)
        is_known = self._own_seen >= _OWN_WINDOWS
        counted_s = min(whole_s, _MOST_SURPRISE * expected_s) if is_known else whole_s
        self._own_carried_s = min(whole_s - counted_s, _OWN_CARRIED * expected_s / windows)
        kept = self._own_weight * (1.0 - min(1.0, windows / _OWN_WINDOWS, elapsed_s / _OWN_S))
        self._own_weight = kept + windows
        self.own_each_s = (kept * self.own_each_s + counted_s) / self._own_weight
        self._own_seen += windows

    def round_s(self, evaluations: int, rows: int, num_steps: int) -> float:
        """One round of the engine with so many rows of num_steps each: its step, and its share of coming and going."""
        turnover = math.ceil(rows / num_steps)
        return self.step.seconds(evaluations) + self.prepare.seconds(turnover) + self.decode.seconds(turnover)

    def window_s(self, num_steps: int, rounds: int, evaluations: int, rows: int) -> float:
        """A window that is done after so many rounds, with two mean deviations of a step on top."""
        doubt = 2.0 * self.step.deviation * self.step.seconds(evaluations)
        return rounds * self.round_s(evaluations, rows, num_steps) + doubt
