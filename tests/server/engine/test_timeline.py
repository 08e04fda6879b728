import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from server.engine.timeline import Timeline


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
