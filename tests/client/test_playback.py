"""The overwrite rule, the playhead and underruns: one by one, and in random sequences from a valid server."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from numpy.typing import NDArray

from motiongen_client import InvalidInput, Playback, ProtocolViolation

FPS = 20.0
SECOND = 20


def rows(plan: int, first_frame: int, num_frames: int) -> NDArray[np.float32]:
    """(T, 2): the plan and the frame of each row."""
    frames = np.arange(first_frame, first_frame + num_frames)
    return np.stack([np.full(num_frames, plan), frames], axis=1).astype(np.float32)


def playback(num_frames: int = 40, **options: int) -> Playback:
    """A playback with one plan of num_frames frames."""
    made = Playback(FPS, 2, **options)
    made.announce_plan(1, 0)
    made.add_chunk(1, 0, rows(1, 0, num_frames), 0)
    return made


def test_playback_does_not_start_before_the_first_frame() -> None:
    empty = Playback(FPS, 2)
    assert list(empty.advance(5.0)) == []
    assert not empty.started
    assert empty.underruns == 0


def test_each_frame_is_reached_once_at_its_time() -> None:
    player = playback()
    assert list(player.advance(100.0)) == [0]
    assert list(player.advance(100.049)) == []
    assert list(player.advance(100.05)) == [1]
    assert list(player.advance(100.25)) == [2, 3, 4, 5]
    assert player.next_due_s() == pytest.approx(100.3)


def test_advancing_at_exact_frame_times_reaches_one_frame_each() -> None:
    player = playback(num_frames=400)
    for frame in range(400):
        assert list(player.advance(0.1 + frame / FPS)) == [frame]
    assert player.underruns == 0


def test_replan_drops_the_frames_it_replaces_and_supplies_new_ones() -> None:
    player = playback()
    player.advance(0.0)
    assert player.announce_plan(2, 10) == 30
    assert player.buffered_to == 10
    player.add_chunk(2, 10, rows(2, 10, 40), 4)
    assert [int(plan) for plan in player.rows(8, 12)[:, 0]] == [1, 1, 2, 2]
    assert (player.plan, player.committed_to, player.late_plans) == (2, 4, 0)


def test_frames_below_valid_from_may_arrive_under_the_new_plan() -> None:
    player = playback(num_frames=10)
    assert player.announce_plan(2, 20) == 0
    player.add_chunk(2, 10, rows(1, 10, 10), 0)
    player.add_chunk(2, 20, rows(2, 20, 20), 0)
    assert player.buffered_to == 40


def test_last_frame_is_held_and_each_frame_time_counts_as_underrun() -> None:
    player = playback(num_frames=3)
    player.advance(0.0)
    assert list(player.advance(0.10)) == [1, 2]
    assert list(player.advance(0.15)) == []
    assert (player.underruns, player.playhead) == (1, 2)
    player.advance(0.16)
    assert player.underruns == 1
    player.advance(0.30)
    assert player.underruns == 4
    player.announce_plan(2, 3)
    player.add_chunk(2, 3, rows(2, 3, 10), 0)
    assert list(player.advance(0.31)) == [3], "no frame is skipped after a hold"
    assert list(player.advance(0.35)) == []
    assert list(player.advance(0.36)) == [4]
    assert player.underruns == 4


@given(calls=st.lists(st.floats(0.0, 0.3), min_size=1, max_size=30))
def test_underruns_do_not_depend_on_how_often_playback_is_advanced(calls: list[float]) -> None:
    """A buffer of 3 frames is shown from 0 s: every frame time after the third is an underrun."""
    player, now_s = playback(num_frames=3), 0.0
    player.advance(now_s)
    for wait_s in calls:
        now_s += wait_s
        player.advance(now_s)
    assert player.underruns == max(int(now_s * FPS + 1e-6) - 2, 0)


def test_late_plan_does_not_change_frames_already_shown() -> None:
    player = playback()
    player.advance(0.0)
    player.advance(0.5)
    assert player.playhead == 10
    player.announce_plan(2, 6)
    player.add_chunk(2, 6, rows(2, 6, 3), 0)
    player.add_chunk(2, 9, rows(2, 9, 10), 0)
    assert player.late_plans == 1
    assert [int(plan) for plan in player.rows(5, 13)[:, 0]] == [1, 1, 1, 1, 1, 1, 2, 2]


def test_pausing_stops_the_clock_without_counting_underruns() -> None:
    player = playback()
    player.advance(0.0)
    player.pause()
    assert list(player.advance(9.0)) == []
    assert player.next_due_s() is None
    player.resume()
    assert list(player.advance(10.0)) == []
    assert list(player.advance(10.05)) == [1]
    assert player.underruns == 0


def test_real_time_playback_may_follow_advance_to() -> None:
    player = playback()
    assert list(player.advance_to(3)) == [0, 1, 2, 3]
    assert list(player.advance(50.0)) == []
    assert list(player.advance(50.05)) == [4]


def test_only_keep_frames_are_kept_behind_the_playhead() -> None:
    player = playback(keep_frames=5)
    player.advance_to(20)
    assert player.first_kept == 15
    with pytest.raises(InvalidInput, match="15 to 39"):
        player.row(14)


@pytest.mark.parametrize("frame", [-1, 40])
def test_advance_to_a_missing_frame_names_the_available_ones(frame: int) -> None:
    with pytest.raises(InvalidInput, match="from 0 to 39"):
        playback().advance_to(frame)


def test_broken_rules_of_plans_and_chunks_are_protocol_violations() -> None:
    player = playback()
    player.announce_plan(2, 40)
    with pytest.raises(ProtocolViolation, match="plan 1 arrived, but the latest plan is 2"):
        player.add_chunk(1, 40, rows(1, 40, 4), 0)
    with pytest.raises(ProtocolViolation, match="begins at frame 41; the next frame is 40"):
        player.add_chunk(2, 41, rows(2, 41, 4), 0)
    with pytest.raises(ProtocolViolation, match="rows of 2 numbers"):
        player.add_chunk(2, 40, np.zeros((1, 3), np.float32), 0)
    player.add_chunk(2, 40, rows(2, 40, 4), 12)
    with pytest.raises(ProtocolViolation, match="committed_to fell from 12 to 11"):
        player.add_chunk(2, 44, rows(2, 44, 4), 11)
    with pytest.raises(ProtocolViolation, match="frames below 12 are committed"):
        player.announce_plan(3, 11)
    with pytest.raises(ProtocolViolation, match="plans must rise"):
        player.announce_plan(2, 44)


def test_frames_before_any_plan_are_a_protocol_violation() -> None:
    player = Playback(FPS, 2)
    with pytest.raises(ProtocolViolation, match="before any plan"):
        player.add_chunk(0, 0, rows(0, 0, 4), 0)
    player.announce_plan(1, 0)
    player.add_chunk(1, 0, rows(1, 0, 4), 0)
    player.restart(4)
    with pytest.raises(ProtocolViolation, match="before any plan"):
        player.add_chunk(0, 4, rows(0, 4, 4), 0)


@pytest.mark.parametrize(
    ("options", "name"), [({"frame_rate_hz": 0.0}, "frame_rate_hz"), ({"keep_frames": -1}, "keep_frames")]
)
def test_options_out_of_range_are_refused(options: dict[str, float], name: str) -> None:
    with pytest.raises(InvalidInput, match=name):
        Playback(**{"frame_rate_hz": FPS, "row_width": 2, **options})  # type: ignore[arg-type]


class PlaybackOfAValidServer(RuleBasedStateMachine):
    """A server that keeps the rules, and a viewer that looks at random times; `true` is the motion that is sent."""

    def __init__(self) -> None:
        super().__init__()
        self.player = Playback(FPS, 2)
        self.now_s = 0.0
        self.plan = 0
        self.sent_to = 0
        self.planned_to = 0
        self.committed_to = 0
        self.true: list[int] = []  # the plan that each frame belongs to
        self.promised: dict[int, int] = {}  # what a committed frame was when it was committed
        self.shown: list[int] = []
        self.num_holds = 0
        self.holding = False

    @rule(at=st.floats(0, 1), length=st.integers(1, SECOND))
    def announce(self, at: float, length: int) -> None:
        first = max(self.committed_to, self.player.playhead + 1 if self.player.started else 0)
        valid_from = min(first + int(at * max(self.planned_to - first + 1, 0)), self.planned_to)
        if valid_from < self.committed_to:
            return
        self.plan += 1
        self.player.announce_plan(self.plan, valid_from)
        self.true[valid_from:] = [self.plan] * length
        self.planned_to, self.sent_to = valid_from + length, min(self.sent_to, valid_from)

    @precondition(lambda self: self.sent_to < self.planned_to)
    @rule(length=st.integers(1, SECOND), commit=st.floats(0, 1))
    def send(self, length: int, commit: float) -> None:
        end = min(self.sent_to + length, self.planned_to)
        data = rows(0, self.sent_to, end - self.sent_to)
        data[:, 0] = self.true[self.sent_to : end]
        self.committed_to = max(self.committed_to, int(commit * end))
        self.player.add_chunk(self.plan, self.sent_to, data, self.committed_to)
        self.sent_to = end
        for frame in range(min(self.committed_to, self.sent_to)):
            self.promised.setdefault(frame, self.true[frame])

    @rule(wait_s=st.floats(0, 0.4))
    def look(self, wait_s: float) -> None:
        self.now_s += wait_s
        underruns = self.player.underruns
        reached = self.player.advance(self.now_s)
        self.num_holds += self.player.underruns > underruns and (bool(reached) or not self.holding)
        self.holding = self.player.underruns > underruns or (self.holding and not reached)
        for frame in reached:
            assert frame == len(self.shown), "every frame is shown once, in order"
            plan, index = self.player.row(frame)
            assert index == frame
            assert plan == self.true[frame], "a frame of a superseded plan was shown"
            self.shown.append(int(plan))

    @invariant()
    def shown_and_committed_frames_do_not_change(self) -> None:
        held = min(self.player.buffered_to, len(self.true))
        assert self.player.late_plans == 0
        for frame in range(min(len(self.shown), held)):
            assert self.player.row(frame)[0] == self.shown[frame]
        for frame, plan in self.promised.items():
            assert self.player.row(frame)[0] == plan

    @invariant()
    def every_frame_time_shows_a_frame_or_counts_as_underrun(self) -> None:
        """Every frame time shows a new frame or is counted as an underrun; the one in which a hold ends may be both."""
        if self.player.started:
            assert len(self.shown) + self.player.underruns <= int(self.now_s * FPS) + 2 + self.num_holds


PlaybackOfAValidServer.TestCase.settings = settings(max_examples=30, stateful_step_count=30, deadline=None)
TestPlaybackOfAValidServer = PlaybackOfAValidServer.TestCase
