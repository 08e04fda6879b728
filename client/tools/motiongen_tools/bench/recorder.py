"""The measurements of a run: latencies as HdrHistograms, counts, and values by second. Recorders can be merged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from motiongen_client.errors import MissingExtra

if TYPE_CHECKING:
    from hdrh.histogram import HdrHistogram

OPEN, EVENT, SCREEN, ANSWER = "open_to_first_frame", "event_to_first_frame", "event_to_screen", "event_to_answer"
LATENESS, SLACK = "chunk_lateness", "chunk_slack"
LATENCIES = (OPEN, EVENT, SCREEN, ANSWER, LATENESS, SLACK)
# Of the generator itself, with the owner GENERATOR: how late it sent, how late its event loop woke, and how long a
# message that was ready waited for gRPC to accept it (which the server can cause by not reading).
SEND_LAG, LOOP_LAG, WRITE_WAIT = "send_lag", "loop_lag", "write_wait"
GENERATOR_LAGS = (SEND_LAG, LOOP_LAG, WRITE_WAIT)
VOIDING_LAGS = (SEND_LAG, LOOP_LAG)
GENERATOR = "generator"
# Of a stream, with the owner STREAMS: from a ping to its pong.
ROUND_TRIP = "round_trip"
STREAMS = "streams"
ALL = "all"

PERCENTILES = {"p50": 50.0, "p90": 90.0, "p95": 95.0, "p99": 99.0, "p99_9": 99.9}

BY_SECOND = ("frames", "due", "missed", "underruns", "edits", "opens", "refused")

_MOST_US = 600_000_000  # ten minutes; longer times are recorded as ten minutes
_DIGITS = 3


def new_histogram() -> HdrHistogram:
    """An empty histogram of microseconds. Raises MissingExtra without HdrHistogram."""
    try:
        from hdrh.histogram import HdrHistogram
    except ImportError:
        raise MissingExtra("motiongen bench", "hdrhistogram", "bench") from None
    return HdrHistogram(1, _MOST_US, _DIGITS)


def summary_ms(histogram: HdrHistogram) -> dict[str, float]:
    """Count, percentiles, mean and maximum, milliseconds; only the count if nothing was recorded."""
    count = int(histogram.get_total_count())
    if count == 0:
        return {"count": 0}
    values = histogram.get_percentile_to_value_dict(list(PERCENTILES.values()))  # all in one pass
    return {
        "count": count,
        **{name: values[percent] / 1000 for name, percent in PERCENTILES.items()},
        "mean": round(histogram.get_mean_value() / 1000, 3),
        "max": histogram.get_max_value() / 1000,
    }


@dataclass(frozen=True)
class PackedBook:
    """The contents of a recorder for other processes, with histograms in their own compressed form."""

    histograms: dict[tuple[str, str], bytes]
    counts: dict[str, int]
    seconds: dict[str, dict[str, list[float]]]


class Recorder:
    """The measurements of one process. groups: names of the scenario's groups; num_seconds: length of the run."""

    def __init__(self, groups: tuple[str, ...], num_seconds: int) -> None:
        self.groups = groups
        self.num_seconds = num_seconds
        self.counts: Counter[str] = Counter()
        self.seconds = {name: {group: [0.0] * num_seconds for group in groups} for name in BY_SECOND}
        self._histograms: dict[tuple[str, str], HdrHistogram] = {}

    def record(self, what: str, group: str, seconds: float) -> None:
        """Record one latency."""
        histogram = self._histograms.get((what, group))
        if histogram is None:
            histogram = self._histograms[what, group] = new_histogram()
        histogram.record_value(min(max(round(seconds * 1e6), 1), _MOST_US))

    def add(self, what: str, group: str, at_s: float, amount: float = 1.0) -> None:
        """Count something in the second in which it happened."""
        second = int(at_s)
        if 0 <= second < self.num_seconds:
            self.seconds[what][group][second] += amount

    def add_span(self, what: str, group: str, from_s: float, to_s: float, rate_hz: float) -> None:
        """Count something that went on at a constant rate."""
        row = self.seconds[what][group]
        for second in range(max(int(from_s), 0), min(int(to_s) + 1, self.num_seconds)):
            row[second] += max(0.0, min(second + 1.0, to_s) - max(float(second), from_s)) * rate_hz

    def histogram(self, what: str, group: str = ALL) -> HdrHistogram:
        """The histogram of one group, or of all together; for reading only."""
        owned = [
            histogram for (name, owner), histogram in self._histograms.items() if name == what and group in (owner, ALL)
        ]
        if len(owned) == 1:
            return owned[0]
        merged = new_histogram()
        for histogram in owned:
            merged.add(histogram)
        return merged

    def total(self, what: str, from_s: int, to_s: int, group: str = ALL) -> float:
        """The sum over the seconds from_s to to_s - 1."""
        rows = self.seconds[what]
        return sum(sum(row[from_s:to_s]) for name, row in rows.items() if group in (name, ALL))

    def by_second(self, what: str) -> Iterator[float]:
        """One value per second, over all groups."""
        return (sum(column) for column in zip(*self.seconds[what].values(), strict=True))

    def pack(self) -> PackedBook:
        histograms = {key: bytes(histogram.encode()) for key, histogram in self._histograms.items()}
        return PackedBook(histograms, dict(self.counts), self.seconds)

    def merge(self, packed: PackedBook) -> None:
        """Add the measurements of another process of the same run."""
        for key, encoded in packed.histograms.items():
            if key not in self._histograms:
                self._histograms[key] = new_histogram()
            self._histograms[key].decode_and_add(encoded)
        self.counts.update(packed.counts)
        for name, rows in packed.seconds.items():
            for group, row in rows.items():
                own = self.seconds[name][group]
                for second, amount in enumerate(row):
                    own[second] += amount
