"""The recorder: percentiles, amounts by second, and merging the recorders of several processes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_tools.bench.recorder import ALL, EVENT, Recorder, summary_ms
from tests.tools.bench.made_up import book_with

latencies = st.lists(st.floats(1e-5, 500.0), min_size=1, max_size=50)


@settings(max_examples=30, deadline=None)
@given(latencies)
def test_percentiles_are_those_of_the_values(seconds: list[float]) -> None:
    summary = summary_ms(book_with(*seconds).histogram(EVENT))
    assert summary["count"] == len(seconds)
    for name, percent in (("p50", 50), ("p99", 99)):
        wanted = np.percentile(seconds, percent, method="inverted_cdf") * 1000
        assert summary[name] == pytest.approx(wanted, rel=0.002, abs=0.002)


@settings(max_examples=15, deadline=None)
@given(latencies, latencies)
def test_merged_recorders_equal_one_recorder(ours: list[float], theirs: list[float]) -> None:
    joined, whole = book_with(*ours), book_with(*ours, *theirs)
    other = book_with(*theirs)
    joined.counts["plans"] = 1
    other.counts["plans"] = 2
    other.add("missed", "crowd", 3.5, 7)
    joined.merge(other.pack())
    assert summary_ms(joined.histogram(EVENT)) == summary_ms(whole.histogram(EVENT))
    assert joined.counts["plans"] == 3
    assert joined.total("missed", 3, 4) == 7
    assert joined.total("missed", 4, 10) == 0


def test_the_group_all_covers_every_group() -> None:
    recorder = Recorder(("hero", "crowd"), 10)
    recorder.record(EVENT, "hero", 0.1)
    recorder.record(EVENT, "crowd", 0.3)
    assert summary_ms(recorder.histogram(EVENT, "hero"))["max"] == pytest.approx(100, rel=0.01)
    assert summary_ms(recorder.histogram(EVENT, ALL))["count"] == 2
    assert summary_ms(recorder.histogram("event_to_screen")) == {"count": 0}


def test_latencies_beyond_the_range_count_as_its_maximum() -> None:
    assert summary_ms(book_with(10_000.0).histogram(EVENT))["max"] == pytest.approx(600_000, rel=0.01)


@settings(deadline=None)
@given(st.floats(0, 12), st.floats(0, 12))
def test_amounts_over_a_span_add_up(one_s: float, other_s: float) -> None:
    from_s, to_s = sorted((one_s, other_s))
    recorder = Recorder(("crowd",), 10)
    recorder.add_span("due", "crowd", from_s, to_s, 20)
    assert recorder.total("due", 0, 10) == pytest.approx(20 * max(min(to_s, 10) - from_s, 0), abs=1e-6)
    recorder.add("due", "crowd", 11.0)
    recorder.add("due", "crowd", -1.0)
    assert recorder.total("due", 0, 10) == pytest.approx(20 * max(min(to_s, 10) - from_s, 0), abs=1e-6)


def test_what_lies_before_or_after_the_run_is_not_counted() -> None:
    recorder = Recorder(("crowd",), 3)
    for at_s in (-1.0, 0.0, 2.9, 3.0):
        recorder.add("edits", "crowd", at_s)
    assert list(recorder.by_second("edits")) == [1, 0, 1]
    recorder.add_span("due", "crowd", -2.0, 1.5, 20)
    recorder.add_span("due", "crowd", 2.5, 9.0, 20)
    assert list(recorder.by_second("due")) == [20, 10, 10]
