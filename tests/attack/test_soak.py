"""How the readings of a soak are judged, by made-up readings with a known result."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.attack.soak_readings import Journal, Part, Reading, judge, slope_with_bound

QUIET = Reading(0.0, False, 100.0, 800.0, 30, 20, 12, 8, 9)
GOOD = Part(opens=100, edits=300, due=10_000, missed=5, refused=0, lag_ms=3.0)


def two_hours(
    mib_an_hour: float = 0.0, descriptors_an_hour: float = 0.0, threads_an_hour: float = 0.0
) -> list[Reading]:
    """Readings of two hours, one every ten seconds, with noise; every five minutes one at rest."""
    random = np.random.default_rng(3)
    readings = []
    for at_s in range(0, 7200, 10):
        hours = at_s / 3600
        mib = 100 + mib_an_hour * hours + float(random.normal(0, 0.3))
        resting = at_s % 300 == 0
        count = 30 + int(descriptors_an_hour * hours) + (0 if resting else 7)
        threads = 12 + int(threads_an_hour * hours)
        readings.append(replace(QUIET, at_s=float(at_s), rest=resting, gateway_mib=mib, gateway_descriptors=count,
                                gateway_threads=threads))  # fmt: skip
    return readings


def test_constant_readings_have_no_faults() -> None:
    _, faults = judge(two_hours(), [GOOD], 1200)
    assert faults == []


def test_late_thread_of_a_pool_is_not_a_leak() -> None:
    told, faults = judge(two_hours(threads_an_hour=0.7), [GOOD], 1200)
    assert "gateway threads at rest: 12 first, 13 last, 13 at most" in told
    assert faults == []


@pytest.mark.parametrize(
    ("readings", "part", "fault"),
    [
        (two_hours(mib_an_hour=1.5), GOOD, "gateway: memory at rest grows"),
        (two_hours(descriptors_an_hour=3), GOOD, "gateway descriptors at rest grew from 31 to"),
        (two_hours(threads_an_hour=4), GOOD, "gateway threads at rest grew from 14 to"),
        (two_hours(), replace(GOOD, missed=200), "2.00% of the frames were missed"),
        (two_hours(), replace(GOOD, failed="exit code 1"), "exit code 1"),
        (two_hours()[:2], GOOD, "memory at rest grows by up to inf"),
        ([], GOOD, "two rests"),
    ],
)
def test_growth_misses_and_failures_are_reported(readings: list[Reading], part: Part, fault: str) -> None:
    _, faults = judge(readings, [part], 1200)
    assert [each for each in faults if fault in each]


def test_bound_of_a_slope_equals_that_of_student_t() -> None:
    """With Student's t for 8 degrees of freedom, 1.8595, and residuals without positive correlation."""
    hours = np.arange(10) / 10
    noise = np.array([1, -1] * 5) / 10
    slope, bound = slope_with_bound(list(hours), list(2 * hours + noise))
    error = math.sqrt(((noise - np.polyval(np.polyfit(hours, noise, 1), hours)) ** 2).sum() / 8)
    error /= math.sqrt(((hours - hours.mean()) ** 2).sum())
    assert slope == pytest.approx(2, abs=0.1)
    assert bound - slope == pytest.approx(1.8595 * error, rel=2e-3)


def test_correlated_residuals_widen_the_bound() -> None:
    hours = list(np.arange(60) / 60)
    walk = list(np.cumsum(np.random.default_rng(1).normal(0, 1, 60)))
    shuffled = list(np.random.default_rng(2).permutation(walk))
    (slope, bound), (plain_slope, plain) = slope_with_bound(hours, walk), slope_with_bound(hours, shuffled)
    assert bound - slope > 1.5 * (plain - plain_slope) * np.std(walk) / np.std(shuffled)


def test_journal_is_read_as_written_and_other_files_are_refused(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "soak" / "readings.jsonl")
    journal.begin({"minutes": 2})
    journal.add(QUIET)
    journal.add(GOOD)
    assert journal.read() == ({"minutes": 2}, [QUIET], [GOOD])
    (tmp_path / "soak" / "readings.jsonl").write_text('{"row": {}}\n')
    with pytest.raises(ValueError, match="not the journal of a soak"):
        journal.read()
