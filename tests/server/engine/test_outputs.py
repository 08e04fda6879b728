"""Outputs on request: made from the frames as they are sent, each velocity from the frame before."""

from __future__ import annotations

import numpy as np

from motiongen_server.engine.session.further_blocks import with_outputs
from motiongen_server.engine.session.timeline import Timeline, TokenRun
from motiongen_server.engine.types import Chunk, CloseReason, SessionKey
from tests.server.engine.fakes import FACTS, ROW_WIDTH, FakeRunner
from tests.server.engine.stage import Stage

KEY = SessionKey(1, 1)
NAMES = ("joint_velocities_mps", "joint_positions_m")


def timeline(first: int, count: int, cut_at: int = 0) -> Timeline:
    """A timeline whose root is at x = frame squared."""
    rows = np.zeros((count, ROW_WIDTH), np.float32)
    rows[:, 0] = np.arange(first, first + count) ** 2
    run = TokenRun(first, np.empty((0, 2), np.float32), 4)
    return Timeline(first, rows, np.zeros((count, 3), np.float32), run, cut_at=cut_at)


def extended(held: Timeline, first: int, end: int) -> np.ndarray:
    chunk = Chunk(KEY, 1, first, held.rows_between(first, end), end)
    return with_outputs(chunk, NAMES, held, FakeRunner().outputs).rows


def test_outputs_follow_the_frame_row_in_the_order_asked_for() -> None:
    rows = extended(timeline(0, 10), 4, 8)
    assert rows.shape == (4, ROW_WIDTH + 6)
    np.testing.assert_allclose(rows[:, ROW_WIDTH], np.array([7, 9, 11, 13]) * FACTS.fps)
    np.testing.assert_allclose(rows[:, ROW_WIDTH + 3], rows[:, 0])


def test_first_frame_and_first_frame_after_a_cut_have_zero_velocity() -> None:
    np.testing.assert_allclose(extended(timeline(0, 10), 0, 3)[:, ROW_WIDTH], np.array([0, 1, 3]) * FACTS.fps)
    cut_within = extended(timeline(0, 10, cut_at=6), 5, 8)[:, ROW_WIDTH]
    np.testing.assert_allclose(cut_within, np.array([9, 0, 13]) * FACTS.fps)


def test_velocity_is_zero_at_each_of_several_cuts() -> None:
    held = timeline(0, 4)
    for frame in (4, 6):
        held = held.spliced(frame, timeline(10 * frame, 4).rows, np.zeros((4, 3), np.float32), anew=True)
    np.testing.assert_allclose(extended(held, 3, 9)[:, ROW_WIDTH], np.array([5, 0, 81, 0, 121, 123]) * FACTS.fps)


def test_prior_frames_give_the_first_frame_a_velocity() -> None:
    np.testing.assert_allclose(extended(timeline(-4, 10, cut_at=-4), 0, 2)[:, ROW_WIDTH], np.array([-1, 1]) * FACTS.fps)


def test_held_pose_does_not_count_as_a_cut() -> None:
    held = timeline(0, 4).held(4)
    assert held.motion_from == 4
    assert extended(held, 4, 6)[0, ROW_WIDTH] == 0
    on = held.spliced(8, timeline(8, 4).rows, np.zeros((4, 3), np.float32))
    assert extended(on, 8, 9)[0, ROW_WIDTH] == (64 - 9) * FACTS.fps


def test_failing_outputs_close_only_their_session() -> None:
    stage = Stage()
    stage.runner.fails = lambda call, job_ids: call == "outputs"
    failing, other = stage.open(1, outputs=NAMES), stage.open(2)
    stage.run(3.0)
    assert failing.closed is not None
    assert failing.closed.reason is CloseReason.ENGINE_FAULT
    assert "joint_velocities_mps" in failing.closed.message
    assert other.closed is None
