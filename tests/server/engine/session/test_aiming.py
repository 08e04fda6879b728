"""What windows get of constraints that may be met at several frames, lie far away, or leave the root free."""

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.session.aiming import Aiming
from motiongen_server.engine.session.placing import REACH
from motiongen_server.engine.session.timeline import Timeline
from motiongen_server.engine.types import (
    VELOCITY_ID,
    JointTargets,
    RigLayout,
    RootPath,
    RootTrajectory,
    Span,
    Unplaced,
    Waypoint,
)
from tests.server.engine.fakes import SPEED
from tests.server.engine.session.playing import playing
from tests.server.engine.stage import Stage

# The fake model walks along +X at SPEED metres a second, whatever it is told.
METRES_A_FRAME = SPEED / 20


def test_waypoint_at_any_frame_is_answered_with_a_frame_and_led_to() -> None:
    stage, viewer = playing()
    asked = Unplaced(Waypoint(5, 0, 60.0, 0.0), at_any_frame=True)
    shown, seq = viewer.shown, stage.set_constraints(viewer, asked)
    stage.run(0.5)
    (placement,) = viewer.outcomes[seq].placements
    assert shown < placement.anchor_frame <= placement.first_frame < placement.arrival_frame
    assert placement.x == pytest.approx((placement.anchor_frame - 1) * METRES_A_FRAME, abs=1e-4)
    led = next(each for each in stage.runner.prepared[-1].constraints if each.constraint_id == VELOCITY_ID)
    assert isinstance(led, RootTrajectory)
    assert led.xz[-1, 0] > led.xz[0, 0]
    assert stage.runner.prepared[-1].keep_prompt is False, "the model may walk where the prompt says to stand"


def test_missed_waypoint_is_aimed_for_again_until_its_last_frame() -> None:
    stage, viewer = playing()
    frame = viewer.buffered_to + 20
    asked = Unplaced(Waypoint(5, frame, 0.0, 30.0), last_frame=frame + 100)
    stage.set_constraints(viewer, asked)
    stage.run(14.0)
    aims = [
        each.frame
        for job in stage.runner.prepared
        for each in job.constraints
        if isinstance(each, Waypoint) and each.constraint_id == 5
    ]
    assert max(aims) == frame + 100
    (reached,) = viewer.reached
    assert not reached.met
    assert frame <= reached.frame <= frame + 100


def test_met_waypoint_is_reported_at_its_frame_and_left_out_of_later_windows() -> None:
    stage, viewer = playing()
    frame = viewer.buffered_to + 20
    place = (frame + 7) * METRES_A_FRAME
    stage.set_constraints(viewer, Unplaced(Waypoint(5, frame, place, 0.0), last_frame=frame + 100))
    stage.run(14.0)
    (reached,) = viewer.reached
    assert (reached.met, reached.frame) == (True, frame + 7)
    assert reached.position_m is not None
    assert reached.position_m.worst < 1e-3
    later = [job for job in stage.runner.prepared if job.first_frame > frame + 60]
    assert later
    assert not any(job.constraints for job in later)


def test_waypoint_with_frames_left_is_accepted_and_one_that_is_over_refused() -> None:
    stage, viewer = playing()
    ahead = viewer.buffered_to + 30
    taken = stage.set_constraints(viewer, Unplaced(Waypoint(5, 1, 0.0, 0.0), last_frame=ahead))
    over = stage.set_constraints(viewer, Unplaced(Waypoint(6, 1, 0.0, 0.0), last_frame=2))
    stage.run(1.0)
    assert viewer.outcomes[taken].reason == ""
    assert viewer.outcomes[over].reason == "FRAME_COMMITTED"


def test_root_path_starts_where_the_character_is() -> None:
    stage, viewer = playing()
    corners = np.array([(20.0, 0.0), (20.0, 5.0)], np.float32)
    seq = stage.set_constraints(viewer, Unplaced(RootPath(3, corners, 1.0, 0.2)))
    stage.run(0.5)
    (placement,) = viewer.outcomes[seq].placements
    path = next(each for each in stage.runner.prepared[-1].constraints if each.constraint_id == 3)
    assert isinstance(path, RootTrajectory)
    assert path.first_frame == placement.anchor_frame
    assert path.xz[0, 0] == pytest.approx(placement.x, abs=0.15)


@pytest.mark.parametrize("is_given", [False, True])
def test_joint_targets_add_a_root_unless_another_constraint_places_it(is_given: bool) -> None:
    going = RootState(1.0, 0.0, 0.5, 0.0, 0.0)
    rig = RigLayout("arm", ("root", "hand"), (-1, 0), np.array([[0, 0, 0], [0.8, 0, 0]]), ())
    aiming = Aiming(rig, 20, Timeline.empty(1, 1), range(100, 200), lambda frame: going)
    hand = JointTargets(2, 120, (1,), np.array([[1.5, 1.0, 2.0]], np.float32))
    roots = aiming.free_roots([hand, Waypoint(3, 120, 1.5, 1.9)] if is_given else [hand])
    if is_given:
        assert roots == ()
    else:
        (root,) = roots
        # In a second the root is at (1.5, 0); it comes only as near as the hand needs to reach.
        assert (root.constraint_id, root.frame) == (VELOCITY_ID, 120)
        assert (root.x, root.z) == pytest.approx((1.5, 2.0 - REACH * 0.8))


def test_free_root_is_placed_on_the_way_to_the_next_waypoint_or_on_the_lead() -> None:
    standing = RootState(0.0, 0.0, 0.0, 0.0, 0.0)
    rig = RigLayout("arm", ("root", "hand"), (-1, 0), np.array([[0, 0, 0], [0.8, 0, 0]]), ())
    aiming = Aiming(rig, 20, Timeline.empty(1, 1), range(100, 200), lambda frame: standing)
    hand = JointTargets(2, 119, (1,), np.array([[0.1, 1.0, 1.0]], np.float32))
    (root,) = aiming.free_roots([hand, Waypoint(3, 139, 0.0, 2.0)])
    assert (root.x, root.z) == pytest.approx((0.0, 1.0))
    lead = RootTrajectory(VELOCITY_ID, 100, np.array([[0.0, 0.1 * (frame + 1)] for frame in range(40)], np.float32))
    within, behind = (JointTargets(2, frame, (1,), hand.positions) for frame in (119, 145))
    roots = aiming.free_roots([within, behind], lead)
    assert [(each.x, each.z) for each in roots] == [
        pytest.approx((0.0, 2.0)),  # where the lead is at that frame
        pytest.approx((0.1, 1.0 + REACH * 0.8), abs=0.02),  # the lead has ended: as near as the hand needs to reach
    ]


def test_open_reports_placements_and_refuses_a_path_that_is_too_long() -> None:
    stage = Stage()
    viewer = stage.open(1, constraints=(Unplaced(Waypoint(5, 0, 3.0, 0.0), at_any_frame=True),))
    far = np.array([(90000.0, 0.0)], np.float32)
    refused = stage.open(2, constraints=(Unplaced(RootPath(3, far, 1.0, 0.2)),))
    stage.run(0.5)
    assert viewer.opened is not None
    (placement,) = viewer.opened.placements
    assert (placement.constraint_id, placement.anchor_frame) == (5, 0)
    assert refused.refused is not None
    assert refused.refused.reason == "PATH_TOO_LONG"
    again = stage.open(2)
    stage.run(0.5)
    assert again.opened is not None


def test_clip_reports_whether_each_of_its_waypoints_was_met() -> None:
    stage = Stage()
    constraints = (
        Unplaced(Waypoint(1, 0, 500.0, 0.0), at_any_frame=True),
        Waypoint(2, 50, 50 * METRES_A_FRAME, 0.0),
        Unplaced(Waypoint(3, 10, 20 * METRES_A_FRAME, 0.0), last_frame=70),
    )
    viewer = stage.open_clip(1, 99, constraints=constraints)
    stage.run(5.0)
    assert viewer.closed is not None
    assert {reached.constraint_id: reached.met for reached in viewer.reached} == {1: False, 2: True, 3: True}


def test_span_gives_a_waypoint_its_first_and_last_frame() -> None:
    waypoint = Waypoint(1, 60, 0.0, 0.0, span=Span(40, 90))
    assert (waypoint.first_frame, waypoint.frame, waypoint.last_frame) == (40, 60, 90)


@pytest.mark.parametrize(("x", "z"), [(30.0, 40.0), (-40.0, 30.0), (0.0, -60.0)])
def test_lead_goes_straight_to_a_far_waypoint_as_fast_as_it_must(x: float, z: float) -> None:
    standing = RootState(1.0, 2.0, 0.0, 0.0, 0.0)
    rig = RigLayout("stick", ("root",), (-1,), np.zeros((1, 3)), ())
    aiming = Aiming(rig, 20, Timeline.empty(1, 1), range(100, 200), lambda frame: standing)
    far = [
        Waypoint(number, 100 + 20 * seconds, 1.0 + x, 2.0 + z, span=Span(100, 5000, is_led=True))
        for number, seconds in ((1, 500), (2, 30))
    ]
    way = aiming.lead(far, 200)
    assert way is not None
    assert (way.first_frame, way.last_frame) == (100, 199)
    along = way.xz - np.array([1.0, 2.0])
    np.testing.assert_allclose(along[:, 0] * z, along[:, 1] * x, atol=1e-3)
    assert along[-1] @ (x, z) > 0
    speed = 20 * float(np.hypot(*(way.xz[-1] - way.xz[-2])))
    assert speed == pytest.approx(float(np.hypot(x, z)) / 29.5, rel=0.01), "the sooner of the two sets the pace"
    assert aiming.lead([each for each in far if each.frame < 200], 200) is None
