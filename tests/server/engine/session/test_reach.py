"""Reached constraints: each is reported once, when its last frame is committed, with how far the motion is off."""

import math

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.session.aiming import Aiming
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.reach import ReachWatch
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import (
    JointRotations,
    Keyframe,
    RootTrajectory,
    SessionKey,
    Span,
    Tolerance,
    Waypoint,
    WindowJob,
)
from tests.server.engine.fakes import FACTS, SPEED
from tests.server.engine.session.playing import playing
from tests.server.engine.stage import Stage

METRES_A_FRAME = SPEED / 20


def test_constraint_is_met_or_missed_by_how_far_its_frame_is_off() -> None:
    there = Waypoint(1, 60, 60 * METRES_A_FRAME, 0.05)
    elsewhere = Waypoint(2, 60, 60 * METRES_A_FRAME, 0.5, heading=1.0)
    stage = Stage()
    viewer = stage.open(constraints=(there, elsewhere))
    stage.run(5.0)
    met, missed = viewer.reached
    assert (met.constraint_id, met.met, met.frame, met.num_frames) == (1, True, 60, 1)
    assert met.position_m is not None
    assert met.position_m.worst == pytest.approx(0.05, abs=1e-5)
    assert met.heading_rad is met.rotation_rad is None
    assert (missed.constraint_id, missed.met) == (2, False)
    assert missed.position_m is not None
    assert missed.position_m.worst == pytest.approx(0.5, abs=1e-5)
    assert missed.heading_rad is not None  # the character faces +Z
    assert missed.heading_rad.worst == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize(("off_m", "within_m", "met"), [(0.3, 0.31, True), (0.3, 0.29, False), (0.09, None, True)])
def test_tolerance_decides_whether_a_constraint_is_met(off_m: float, within_m: float | None, met: bool) -> None:
    tolerance = Tolerance() if within_m is None else Tolerance(within_m, 0.1)
    stage = Stage()
    viewer = stage.open(constraints=(Waypoint(1, 50, 50 * METRES_A_FRAME, off_m, None, tolerance),))
    stage.run(5.0)
    assert [reached.met for reached in viewer.reached] == [met]


def test_constraint_is_reported_once_and_only_when_its_frame_is_committed() -> None:
    stage, viewer = playing()
    frame = viewer.committed_to + 20
    stage.set_constraints(viewer, Waypoint(7, frame, 0.0, 0.0))
    while not viewer.reached:
        assert viewer.committed_to <= frame
        stage.run(0.05)
    assert viewer.committed_to > frame
    stage.run(5.0)
    assert [reached.constraint_id for reached in viewer.reached] == [7]


def test_path_longer_than_the_kept_frames_is_measured_as_a_whole() -> None:
    count = 400
    path = np.zeros((count, 2), np.float32)
    path[:, 0] = np.arange(30, 30 + count) * METRES_A_FRAME
    path[3, 1] = 0.4  # one place that the motion misses
    stage = Stage()
    viewer = stage.open(constraints=(RootTrajectory(3, 30, path),))
    stage.run(30.0)
    (reached,) = viewer.reached
    assert (reached.frame, reached.num_frames, reached.met) == (429, count, False)
    assert reached.position_m is not None
    assert reached.position_m.worst == pytest.approx(0.4, abs=1e-4)
    assert reached.position_m.mean == pytest.approx(0.4 / count, abs=1e-4)


def test_removed_constraint_is_not_reported_and_a_replaced_one_only_once() -> None:
    stage, viewer = playing()
    ahead = viewer.buffered_to + 40
    stage.set_constraints(viewer, Waypoint(1, ahead, 0.0, 0.0), Waypoint(2, ahead, 0.0, 0.0))
    stage.run(0.2)
    stage.set_constraints(viewer, Waypoint(2, ahead + 10, (ahead + 10) * METRES_A_FRAME, 0.0), remove=(1,))
    stage.run(8.0)
    assert [(reached.constraint_id, reached.frame, reached.met) for reached in viewer.reached] == [
        (2, ahead + 10, True)
    ]


def test_residual_is_measured_on_the_frames_that_are_sent() -> None:
    stage = Stage()
    stage.runner.moves = walks_off
    viewer = stage.open(constraints=(Keyframe(4, 20, np.array([[0.0, 1.0, 0.0]], np.float32)),))
    stage.run(3.0)
    (reached,) = viewer.reached
    assert reached.position_m is not None
    assert reached.position_m.worst == pytest.approx(math.hypot(20 * METRES_A_FRAME, 2.0), abs=1e-4)


def walks_off(job: WindowJob, frames: np.ndarray) -> None:
    """Move the frames two metres to the side."""
    del job
    frames[:, 2] += 2.0


def test_clip_reports_every_constraint_before_it_closes() -> None:
    stage = Stage()
    constraints = tuple(Waypoint(number, 99 - number, 0.0, 0.0) for number in range(1, 5))
    viewer = stage.open_clip(1, 99, constraints=constraints)
    stage.run(5.0)
    assert viewer.closed is not None
    assert [reached.constraint_id for reached in viewer.reached] == [4, 3, 2, 1]  # in the order of their frames


def test_joint_positions_are_computed_once_for_any_number_of_constraints(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, viewer = playing()
    timeline = stage.engine.sessions[viewer.key].timeline
    turned = np.diag([1.0, -1.0, -1.0]).astype(np.float32)[None]
    held = tuple(JointRotations(each, 5, (0,), turned, span=Span(0, 1 << 50)) for each in range(1, 257))
    forward = Posed._forward
    worked_out: list[int] = []

    def noted(posed: Posed) -> tuple[np.ndarray, np.ndarray]:
        worked_out.append(len(posed))
        return forward(posed)

    monkeypatch.setattr(Posed, "_forward", noted)
    assert ReachWatch(SessionKey(1, 1)).reached(FACTS.rig, Conditions((), held), timeline, 20) == []
    assert worked_out == [20], "each of their chunks delays all other sessions by this"
    window = range(30, 100)
    aiming = Aiming(FACTS.rig, FACTS.fps, timeline, window, lambda frame: RootState(0.0, 0.0, 0.0, 0.0, 0.0))
    assert len(aiming.aimed(held)) == len(held)
    assert worked_out == [20, 30]


def test_constraint_is_due_when_its_last_frame_is_committed_and_not_before() -> None:
    watch, rows = ReachWatch(SessionKey(1, 1)), np.zeros((80, FACTS.row_width), np.float32)
    rows[:, 3] = 1.0  # a quaternion
    timeline = Timeline.empty(FACTS.row_width, 1).spliced(0, rows, rows[:, :1])
    conditions = Conditions(
        constraints=(RootTrajectory(1, 30, np.zeros((11, 2), np.float32)), Waypoint(2, 40, 0.0, 0.0))
    )
    told = []
    for committed_to in (20, 35, 40, 41, 42):
        is_due = watch.is_due(conditions, committed_to)
        reached = watch.reached(FACTS.rig, conditions, timeline, committed_to)
        told.append((is_due, [(each.constraint_id, each.num_frames) for _, each in reached]))
        conditions = conditions.without_told([constraint for constraint, _ in reached])
    assert told == [(False, []), (False, []), (False, []), (True, [(1, 11), (2, 1)]), (False, [])]
