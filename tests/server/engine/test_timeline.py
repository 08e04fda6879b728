import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from server.engine.timeline import PlaybackClock, Timeline
from server.engine.types import PlayState


def _frames(begin: int, end: int) -> np.ndarray:
    return np.repeat(np.arange(begin, end, dtype=np.float32)[:, None], 3, axis=1)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(1, 40), st.integers(0, 60)), max_size=8))
def test_a_timeline_is_the_list_of_frames_it_stands_for(edits: list[tuple[int, int, int]]) -> None:
    timeline = Timeline.empty(3, 3)
    whole: list[float] = []
    for marker, (back, count, trim) in enumerate(edits):
        frame = max(timeline.first, timeline.end - back)
        rows = np.full((count, 3), marker, np.float32)
        timeline = timeline.spliced(frame, rows, rows)
        whole = whole[:frame] + [float(marker)] * count
        timeline = timeline.trimmed(min(trim, timeline.end))
        assert timeline.end == len(whole)
        assert timeline.rows[:, 0].tolist() == whole[timeline.first :]
        assert timeline.features[:, 0].tolist() == whole[timeline.first :]


def test_history_is_what_comes_just_before() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 40), _frames(0, 40)).trimmed(10)
    assert timeline.features_before(20, 8)[:, 0].tolist() == list(range(12, 20))
    assert timeline.features_before(20, 0).shape == (0, 3)
    assert timeline.rows_between(12, 14)[:, 0].tolist() == [12, 13]


def test_a_view_stays_true_when_the_timeline_goes_on() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 40), _frames(0, 40))
    view = timeline.rows_between(10, 20)
    timeline.spliced(12, _frames(100, 140), _frames(100, 140)).trimmed(30)
    assert view[:, 0].tolist() == list(range(10, 20))


def test_trimming_frees_the_memory() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 1000), _frames(0, 1000)).trimmed(990)
    assert timeline.rows.base is None
    assert len(timeline.rows) == 10


def test_the_playhead_stands_at_0_until_its_first_report() -> None:
    clock = PlaybackClock(20)
    assert clock.estimate(1000.0, 40) == 0
    assert clock.reaches_at(10) == math.inf
    clock.report(0, 1000.0, 40)
    assert clock.estimate(1000.5, 40) == 10
    assert clock.reaches_at(10) == 1000.5


def test_the_playhead_runs_no_further_than_what_was_sent() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    assert clock.estimate(0.25, 40) == 35
    assert clock.estimate(9.0, 40) == 40
    assert clock.unheld(9.0) == 210


def test_after_an_underrun_playback_goes_on_from_where_it_waited() -> None:
    clock = PlaybackClock(20)
    clock.report(30, 0.0, 40)
    clock.resume_from(40, 9.0)
    assert clock.estimate(9.5, 80) == 50


def test_a_report_of_a_frame_never_sent_counts_as_what_was_sent_and_a_lower_one_not_at_all() -> None:
    clock = PlaybackClock(20)
    clock.report(2**63, 0.0, 40)
    assert clock.reported == 40
    clock.report(12, 0.5, 60)
    assert clock.reported == 40
    assert clock.estimate(0.5, 60) == 50


def test_pause_stops_the_playhead_where_it_is() -> None:
    clock = PlaybackClock(20)
    clock.report(0, 0.0, 40)
    clock.set_state(PlayState.PAUSED, 0.5, 40)
    assert clock.estimate(7.0, 40) == 10
    assert clock.reaches_at(11) == math.inf
    clock.set_state(PlayState.PLAYING, 8.0, 40)
    assert clock.estimate(8.5, 40) == 20
