"""What the playback of a character counts: time without a frame, latencies of edits, changes of committed frames."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_server.engine.types import Chunk, Code, Outcome, PlanCause, PlanNotice, SessionKey
from tests.bench.playback import Playback

KEY = SessionKey(1, 0)


def chunk(first_frame: int, num_frames: int, committed_to: int = 0) -> Chunk:
    return Chunk(KEY, 1, first_frame, np.zeros((num_frames, 3), np.float32), committed_to)


def notice(valid_from: int) -> PlanNotice:
    return PlanNotice(KEY, 2, valid_from, PlanCause.EDIT, ())


@pytest.fixture
def playback() -> Playback:
    """A playback with 20 frames, ten a second, from second 10 on."""
    playing = Playback(fps=10)
    playing.receive(chunk(0, 20), 10.0)
    return playing


def test_frames_in_time_miss_nothing(playback: Playback) -> None:
    playback.receive(chunk(20, 20), 11.9)
    assert playback.held_between(10.0, 14.0) == 0.0
    assert playback.frame_at(13.05) == 30


def test_late_frame_stops_playback_and_counts_from_when_it_was_due(playback: Playback) -> None:
    playback.receive(chunk(20, 20), 12.5)
    assert playback.held_between(0.0, 13.0) == pytest.approx(10.0 + 0.5)
    assert playback.held_between(12.2, 13.0) == pytest.approx(0.3)
    assert playback.frame_at(12.65) == 21


def test_missing_frames_count_to_the_end(playback: Playback) -> None:
    assert playback.held_between(10.0, 14.0) == pytest.approx(2.0)
    assert Playback(fps=10).held_between(3.0, 5.0) == 2.0


def test_latency_of_an_edit_ends_at_its_first_changed_frame(playback: Playback) -> None:
    playback.meant(7, 10.5)
    playback.answer(Outcome(KEY, 7, Code.OK, effective_frame=15))
    playback.notice(notice(12), 10.8)
    playback.receive(chunk(12, 3), 10.8)
    assert playback.latencies_s == []
    playback.receive(chunk(15, 8), 11.0)
    assert playback.latencies_s == [pytest.approx(0.5)]


def test_refused_edit_is_counted_as_refused(playback: Playback) -> None:
    playback.meant(7, 10.5)
    playback.answer(Outcome(KEY, 7, Code.RESOURCE_EXHAUSTED, None, "FULL"))
    playback.receive(chunk(20, 8), 11.0)
    assert playback.latencies_s == []
    assert playback.num_refused == 1


@pytest.mark.parametrize(("valid_from", "broken"), [(12, 0), (11, 0), (10, 1), (4, 1)])
def test_plan_that_replaces_shown_frames_counts_as_broken(playback: Playback, valid_from: int, broken: int) -> None:
    playback.notice(notice(valid_from), 11.05)  # frame 10 is being shown
    assert playback.broken == broken


def test_plan_that_replaces_committed_frames_counts_as_broken() -> None:
    playback = Playback(fps=10)
    playback.receive(chunk(0, 20, committed_to=6), 10.0)
    playback.notice(notice(5), 10.0)
    assert playback.broken == 1
