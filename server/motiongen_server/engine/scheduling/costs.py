"""CostTable: seconds that preparing windows, a denoising step, and decoding take, by the size of the call.

Filled by a profile at start-up and updated from then on. Sizes are counted in buckets; the cost of a bucket is a
running mean of its measurements. The curve over all buckets is made from these means so that it never falls with size.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field

_LEARNING_RATE = 0.125
# How fast the cost of one size relative to the others follows measurements.
_SHAPE_RATE = 1 / 128
# The pace is a mean over about _PACE_CALLS calls or _PACE_S, whichever is fewer calls, but over _LEAST_PACE_CALLS at
# least. Measured in processor time, which neighbours cannot take away, it looks back _LONGER times further, since calls
# are dear for just a few seconds while sessions open. Not further still: calls become dearer or cheaper as other work
# on the machine changes, and admission must follow that.
_PACE_CALLS, _LEAST_PACE_CALLS = 32, 8
_PACE_S = 2.0
_LONGER = 3
# A single outlier must not pass for the new normal: a measurement counts as at most so many times the expected time.
# The excess counts with the calls that follow, up to as long as a quota of processor time can stop a process.
_MOST_SURPRISE = 4.0
_MOST_CARRIED_S = 0.1
_REFRESH_EVERY = 8
_LEAST_S = 1e-7
_MOST_WEIGHT = 32.0
# The engine's own time per window is a mean over the windows of the last _OWN_S, and over _OWN_WINDOWS at least: with a
# GPU this many come and go in a fifth of a second, which would reflect a single wave only. An excess counts with the
# windows that follow, as the time of _OWN_CARRIED windows at most. The value measured before the engine serves counts
# as just _OWN_MEASURED windows, so that the first sessions correct it where it was wrong.
_OWN_S, _OWN_WINDOWS, _OWN_CARRIED, _OWN_MEASURED = 1.0, 128, 32, 32
_LEAST_OWN_S = 1e-5


def _grid(most: int) -> tuple[int, ...]:
    """1, 2, ... 8, and from there on four sizes per doubling."""
    sizes = [*range(1, 8)]
    octave = 8
    while octave <= most:
        sizes += [octave + octave * quarter // 4 for quarter in range(4)]
        octave *= 2
    return tuple(sizes)


SIZES = _grid(1 << 14)


def bucket(size: int) -> int:
    """The size under which this many rows, evaluations or jobs are counted: the least of SIZES that holds them."""
    return SIZES[min(bisect_left(SIZES, size), len(SIZES) - 1)]


@dataclass(slots=True)
class Pace:
    """How slow the device has been lately: the time that calls took, relative to what their sizes usually take.

    A neighbour that takes the cores, or a quota that is used up, slows down calls of every kind and size. The pace is a
    ratio of sums: a mean of ratios would be too large where calls are uneven, as they are when the processor is taken
    away now and then, and the pace of one kind of call alone would be known late, since there are few of them. longer:
    how many times further to look back.

    by_size: a call counts by its size. One that finds the caches taken by others costs a millisecond or two more, which
    is much of a small call and little of a large one; prices are those of large calls, so large calls must dominate.
    """

    longer: int = 1
    by_size: bool = False
    value: float = 1.0
    _spent_s: float = 0.0
    _usual_s: float = 0.0
    _carried_s: float = 0.0

    def observe(self, size: int, usual_s: float, seconds: float) -> float:
        """Record the time of a call that usually takes usual_s. Returns its ratio to the expected time, as counted."""
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
    """What one kind of call costs by its size. assumed_s: the cost of any size before anything was measured.

    deviation: the mean distance of measurements from the expected time, as a share of it. pace: the device's, shared by
    all kinds of calls. spent: the same measured in processor time, None if that is not known; a process that stands
    still because its quota is used up is late, but uses nothing of the quota.
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
        """Set the cost of a size to what a profile measured."""
        index = bisect_left(SIZES, size)
        self._means[index], self._weights[index] = max(seconds / self.pace.value, _LEAST_S), 1.0
        self._forget_curve()

    def observe(self, size: int, seconds: float, spent_s: float | None = None) -> None:
        """Record the time of a call of this size. spent_s: its processor time; None if not known: all of its time."""
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
        """The mean that a size starts with before it was ever measured; None: the time of its first call.

        One measurement says little, so between known sizes it starts with what these imply. A size below all known ones
        may cost less than the smallest of them, and a larger one less than in proportion, so a faster call is taken as
        it is. A slower one may just have been interrupted: taken as it is, it would keep that size from being tried
        again, or distort the costs of the others.
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
        """The expected time of a call of this size; it never falls as the size rises. 0 for size 0."""
        return self.pace.value * self._usual_s(size) if self._means else self._assumed_s(size)

    def each_s(self, size: int) -> float:
        """The expected time per item in a call of this size."""
        return self.seconds(size) / max(1, size)

    def spent_each_s(self, size: int) -> float:
        """The expected processor time per item in a call of this size; as `each_s` if processor time is not known."""
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
        """The largest bucket whose expected time is at most this; 0 if there is none."""
        if not self._means:
            return SIZES[-1] if self.assumed_s <= seconds else 0
        self.seconds(1)  # makes the curve
        index = bisect_right(self._curve, seconds, key=lambda usual_s: self.pace.value * usual_s)
        return SIZES[index - 1] if index else 0

    def efficient_from(self, most: int, waste: float) -> int:
        """The smallest bucket in which an item costs at most `waste` times what it costs in a call of size `most`."""
        self.seconds(1)
        key = (most, waste)
        if key not in self._efficient:
            limit_s = waste * self.each_s(most)
            self._efficient[key] = next((size for size in SIZES if self.each_s(size) <= limit_s), most)
        return self._efficient[key]


def _monotone_curve(means: dict[int, float], weights: dict[int, float]) -> list[float]:
    """Seconds for every size of the grid: monotone means, interpolated linearly, in proportion to size beyond the last.

    Means that fall as the size rises are replaced by their weighted mean (pool adjacent violators), so that a rarely
    measured size yields to its neighbours.
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
        # The last point is taken exactly: a rounding error must not make the curve fall there.
        curve += [min(low_s + slope * (SIZES[index] - SIZES[low]), high_s) for index in range(low + 1, high)]
        curve.append(high_s)
    last, last_s = known[-1]
    curve += [last_s * SIZES[index] / SIZES[last] for index in range(last + 1, len(SIZES))]
    return curve


@dataclass(slots=True)
class CostTable:
    """Seconds by size of call. prepare, decode: by windows. step: by evaluations of the denoiser, over all rows.

    own_each_s: the engine's own time per window, between calls.
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
        """A table without measurements: a step costs step_s, all else nothing."""
        pace = Pace()
        return cls(CallCosts(0.0, pace), CallCosts(step_s, pace), CallCosts(0.0, pace))

    def follow_processor(self) -> None:
        """From now on, calls are recorded with their processor time."""
        spent = Pace(longer=_LONGER, by_size=True)
        for costs in (self.prepare, self.step, self.decode):
            costs.spent = spent

    def begin_own(self, each_s: float) -> None:
        """Set the engine's own time per window, as measured before it serves."""
        self.own_each_s, self._own_seen, self._own_weight = each_s, _OWN_WINDOWS, float(_OWN_MEASURED)

    def observe_own(self, windows: int, seconds: float, elapsed_s: float = math.inf) -> None:
        """Record the engine's own time between calls, from the end of the previous windows to the end of these.

        elapsed_s: all the time between those ends, calls and idling included. Time beyond a multiple of what was
        expected counts with the windows that follow, up to the time that some windows take: an engine that stands still
        for a second, for example while another model is loaded, is not slower from then on.
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
        """One round with this many rows of num_steps each: the step, and its share of preparing and decoding."""
        turnover = math.ceil(rows / num_steps)
        return self.step.seconds(evaluations) + self.prepare.seconds(turnover) + self.decode.seconds(turnover)

    def window_s(self, num_steps: int, rounds: int, evaluations: int, rows: int) -> float:
        """A window that takes this many rounds, plus two mean deviations of a step."""
        doubt = 2.0 * self.step.deviation * self.step.seconds(evaluations)
        return rounds * self.round_s(evaluations, rows, num_steps) + doubt
