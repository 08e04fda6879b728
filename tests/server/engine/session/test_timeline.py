import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.session.timeline import Timeline, TokenRun, first_timeline
from motiongen_server.engine.types import WindowJob
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import Stage


def _frames(begin: int, end: int) -> np.ndarray:
    return np.repeat(np.arange(begin, end, dtype=np.float32)[:, None], 3, axis=1)


@given(st.lists(st.tuples(st.integers(0, 50), st.integers(1, 40), st.integers(0, 60)), max_size=8))
def test_timeline_equals_a_plain_list_of_its_frames(edits: list[tuple[int, int, int]]) -> None:
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


def test_history_is_the_frames_just_before_a_frame() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 40), _frames(0, 40)).trimmed(10)
    assert timeline.features_before(20, 8)[:, 0].tolist() == list(range(12, 20))
    assert timeline.features_before(20, 0).shape == (0, 3)
    assert timeline.rows_between(12, 14)[:, 0].tolist() == [12, 13]


def test_view_of_rows_is_not_changed_by_later_splices() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 40), _frames(0, 40))
    view = timeline.rows_between(10, 20)
    timeline.spliced(12, _frames(100, 140), _frames(100, 140)).trimmed(30)
    assert view[:, 0].tolist() == list(range(10, 20))


def test_trimmed_frames_are_released_at_the_next_splice() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 1000), _frames(0, 1000)).trimmed(990)
    assert len(timeline.rows) == 10
    timeline = timeline.spliced(1000, _frames(1000, 1040), _frames(1000, 1040))
    assert (len(timeline.rows), timeline.rows.base) == (50, None)


# ---- tokens ----------------------------------------------------------------------------------------------------------


@given(
    st.lists(st.tuples(st.integers(0, 50), st.integers(1, 40), st.booleans(), st.integers(0, 80)), max_size=8),
    st.integers(0, 300),
    st.integers(0, 8),
)
def test_tokens_stand_for_exactly_the_frames_before_or_are_not_given(
    edits: list[tuple[int, int, bool, int]], frame: int, count: int
) -> None:
    """A window's token carries its window and its first frame; the frames carry the same."""
    run = TokenRun(0, np.empty((0, 2), np.float32), 4)
    whole: list[tuple[int, int]] = []
    for window, (back, num_frames, known, trim) in enumerate(edits):
        first = max(0, len(whole) - back)
        tokens = np.array([(window, first + offset) for offset in range(0, 40, 4)], np.float32)
        run = run.spliced(first, tokens if known else None, num_frames).trimmed(trim)
        whole = whole[:first] + [(window, first + offset // 4 * 4) for offset in range(num_frames)]
    given_tokens = run.before(frame, 4 * count)
    if given_tokens is not None:
        assert len(given_tokens) == count
        frames = whole[frame - 4 * count : frame]
        assert [tuple(token) for token in given_tokens for _ in range(4)] == frames


def test_tokens_of_windows_on_one_grid_join_and_others_start_a_new_run() -> None:
    tokens = np.arange(20, dtype=np.float32).reshape(10, 2)
    run = TokenRun(0, tokens[:0], 4).spliced(0, tokens, 40).spliced(40, tokens, 40)
    assert (run.first, run.end) == (0, 80)
    joined = run.spliced(60, tokens, 40)
    assert (joined.first, joined.end) == (0, 100)
    assert joined.before(64, 16) is not None
    anew = run.spliced(61, tokens, 39)
    assert (anew.first, anew.end) == (61, 97)
    assert anew.before(73, 16) is None
    assert anew.before(77, 16) is not None


def test_held_pose_repeats_the_last_row_and_is_not_in_histories() -> None:
    frames = _frames(0, 40)
    timeline = Timeline.empty(3, 3, 1, 4).spliced(0, frames, frames, frames[::4, :1])
    held = timeline.held(6)
    assert (held.end, held.motion_from) == (46, 6)
    assert held.rows[:, 0].tolist() == [*range(40), *[39] * 6]
    assert held.features_before(46, 16)[:, 0].tolist() == list(range(24, 40))
    tokens = held.tokens_before(46, 16)
    assert tokens is not None
    assert tokens[:, 0].tolist() == [24, 28, 32, 36]
    assert timeline.end == 40


def test_frames_made_anew_set_where_the_motion_begins() -> None:
    timeline = Timeline.empty(3, 3).spliced(0, _frames(0, 40), _frames(0, 40))
    assert timeline.spliced(30, _frames(30, 70), _frames(30, 70)).motion_from == 0
    assert timeline.spliced(30, _frames(30, 70), _frames(30, 70), anew=True).motion_from == 30


def test_rows_made_before_exclude_those_before_a_cut_a_hold_or_the_session() -> None:
    timeline = Timeline.empty(3, 3, 1, 4).spliced(0, _frames(0, 40), _frames(0, 40))
    assert timeline.made_before(20, 8)[:, 0].tolist() == list(range(12, 20))
    assert timeline.made_before(5, 8)[:, 0].tolist() == list(range(5))
    assert len(timeline.made_before(20, 0)) == 0
    assert timeline.trimmed(15).made_before(20, 8)[:, 0].tolist() == list(range(15, 20))
    assert len(timeline.held(6).made_before(46, 8)) == 0
    cut = timeline.spliced(30, _frames(30, 70), _frames(30, 70), anew=True)
    assert cut.made_before(34, 8)[:, 0].tolist() == list(range(30, 34))
    assert len(cut.made_before(30, 8)) == 0
    begun = first_timeline(FACTS, np.ones((8, FACTS.row_width), np.float32), np.ones((8, 3), np.float32))
    assert len(begun.made_before(0, 8)) == 0


def test_quaternions_keep_their_sign_from_window_to_window() -> None:
    stage = Stage()

    def flips(job: WindowJob, frames: np.ndarray) -> None:
        frames[:, 3:7] = (0.8, 0.6, 0.0, 0.0) if job.plan % 2 else (-0.8, -0.6, 0.0, 0.0)

    stage.runner.moves = flips
    viewer = stage.open()
    stage.run(7.0)
    assert {job.plan % 2 for job in stage.runner.prepared} == {0, 1}
    assert np.allclose(np.stack(viewer.rows)[:, 3:7], (0.8, 0.6, 0.0, 0.0))
