"""The result of a run: its figures, what makes it void, and the shortfalls in service."""

from __future__ import annotations

from dataclasses import replace

import pytest

from motiongen_tools.bench.recorder import EVENT
from tests.tools.bench.made_up import SECONDS, book_with, make_result


def test_figures_cover_only_the_measured_seconds() -> None:
    figures = make_result(missed=20).figures()
    assert (figures.due, figures.missed) == (1000, 20)
    assert figures.miss_ratio == pytest.approx(0.02)
    assert figures.on_time_per_s == pytest.approx(980 / SECONDS)
    assert make_result(missed=1001).figures().on_time_per_s == 0, "frames that were due before are missed too"
    received = make_result()
    for second in (received.phases.measure_from_s - 1, received.phases.measure_to_s - 1, received.phases.measure_to_s):
        received.recorder.add("frames", "crowd", second, 300)
    assert received.figures().frames_per_s == pytest.approx(300 / SECONDS)


@pytest.mark.parametrize(("characters", "ratio"), [(20, 1.0), (2, 0.0)])
def test_no_frames_due_counts_as_all_missed_unless_the_group_is_empty(characters: int, ratio: float) -> None:
    result = make_result(scenario="mixed", characters=characters)  # one in twenty is a hero
    result.recorder.seconds["due"]["hero"] = [0.0] * result.recorder.num_seconds
    assert result.figures("hero").miss_ratio == ratio
    for row in result.recorder.seconds["due"].values():
        row[:] = [0.0] * len(row)
    assert result.figures().miss_ratio == 1.0


@pytest.mark.parametrize(("lag_ms", "void"), [(4.9, 0), (5.1, 2)])
def test_a_late_generator_makes_the_run_void(lag_ms: float, void: int) -> None:
    reasons = make_result(lag_ms=lag_ms).void_reasons()
    assert len(reasons) == void
    assert all("5.1 ms (p99); 5 ms is allowed" in reason for reason in reasons)


def test_a_run_in_which_nothing_was_to_be_sent_counts() -> None:
    result = replace(make_result(), recorder=book_with())
    assert result.void_reasons() == []
    assert result.headline() == "crowd, 10 characters: 100.00% of frames missed"


def test_few_missed_frames_and_full_service_are_no_shortfall() -> None:
    assert make_result(missed=9, counts={"service level: FULL, 4 steps": 3, "plans": 7}).shortfalls() == []


@pytest.mark.parametrize(
    ("missed", "counts", "shortfall"),
    [
        (10, {}, "1.00% of frames were missed; less than 1.00% is allowed"),
        (0, {"refused open: SERVER_FULL": 2}, "refused open: SERVER FULL (2 times)"),
        (0, {"refused edit: RATE_LIMITED": 1}, "refused edit: RATE LIMITED (1 times)"),
        (0, {"sessions_lost: SLOW_READER": 1}, "sessions lost: SLOW READER (1 times)"),
        (0, {"service level: FEWER_STEPS, 2 steps": 5}, "service level: FEWER STEPS, 2 steps (5 times)"),
        (0, {"protocol_breaches": 1}, "protocol breaches (1 times)"),
    ],
)
def test_shortfalls_are_named(missed: int, counts: dict[str, int], shortfall: str) -> None:
    assert make_result(missed=missed, counts=counts).shortfalls() == [shortfall]


def test_an_underrun_of_a_hero_is_a_shortfall() -> None:
    assert make_result(scenario="hero", hero_underruns=1).shortfalls() == [
        "playback of hero stood still 1 times; HERO never may"
    ]
    assert make_result(scenario="crowd", hero_underruns=1).shortfalls() == []


def test_headline_and_groups_of_a_result() -> None:
    result = make_result(scenario="mixed", missed=30)
    assert result.groups() == ["all", "hero", "near", "crowd"]
    assert result.headline() == (
        "mixed, 10 characters: 1.00% of frames missed; event to first changed frame 50 ms (p50), 99 ms (p99)"
    )
    assert result.latency_ms(EVENT, "near")["count"] == 100
    assert make_result().groups() == ["all"]
