"""Conversion of valid events to the engine's, and of outputs to messages."""

from __future__ import annotations

import math

import numpy as np
import pytest
from google.protobuf.duration_pb2 import Duration

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Guidance,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    Open,
    Opened,
    Outcome,
    PlanCause,
    Playhead,
    PlayState,
    Priority,
    RootPath,
    RootTrajectory,
    ServiceLevel,
    ServiceTier,
    SetConstraints,
    SetPlayState,
    SetPrompts,
    SetVelocity,
    StartPose,
    Unplaced,
    Waypoint,
)
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.convert import round_trip_s
from motiongen_server.rpc.limits import MAX_SPEED_MPS
from tests.server.engine.fakes import FACTS
from tests.server.rpc.convert.conversion import KEY, attempt, convert, updated

# ---- valid events ---------------------------------------------------------------------------------------------------


def test_every_field_of_an_open_arrives() -> None:
    message = session_pb2.OpenSession(
        request_id="mine",
        seed=5,
        priority=session_pb2.PRIORITY_CLASS_CROWD,
        lookahead_frames=60,
        denoise_steps=7,
        guidance=session_pb2.Guidance(text=3.0),
        prompts=[motion_pb2.PromptSpan(prompt_id=2, start_frame=8, end_frame=20, text="walk")],
        constraints=[motion_pb2.Constraint(constraint_id=4, frame=30, waypoint=motion_pb2.Waypoint(x=1, z=2))],
        start_pose=session_pb2.StartPose(x=-1, z=0.5, heading=0.25),
        keep_prompts=True,
    )
    event = convert(session_pb2.SessionEvent(event_seq=1, open=message))
    assert isinstance(event, Open)
    spec = event.spec
    assert (spec.session, spec.seed, spec.model_id, spec.priority) == (KEY, 5, FACTS.model_id, Priority.CROWD)
    assert (spec.lookahead, spec.denoise_steps, spec.guidance) == (60, 7, Guidance(3.0, 2.5))
    assert spec.start_pose == StartPose(-1.0, 0.5, 0.25)
    assert spec.keep_prompts
    (prompt,) = spec.prompts
    assert (prompt.prompt_id, prompt.start_frame, prompt.end_frame, prompt.text) == (2, 8, 20, "walk")
    np.testing.assert_array_equal(prompt.embedding, [4, 4])
    assert spec.constraints == (Waypoint(4, 30, 1.0, 2.0, None),)


def test_an_empty_open_gets_the_defaults_and_a_seed_of_its_own() -> None:
    events = [convert(session_pb2.SessionEvent(event_seq=1, open=session_pb2.OpenSession())) for _ in range(2)]
    specs = [event.spec for event in events if isinstance(event, Open)]
    assert (specs[0].priority, specs[0].lookahead, specs[0].denoise_steps) == (Priority.NEAR, 40, FACTS.default_steps)
    assert specs[0].guidance == Guidance(1.5, 2.5)
    assert specs[0].start_pose == StartPose(0.0, 0.0, 0.0)
    assert specs[0].seed != specs[1].seed
    assert not specs[0].keep_prompts


def test_absent_frames_of_a_prompt_arrive_as_none() -> None:
    edit = session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan(prompt_id=1, text="sit")], remove=[7])
    event = convert(session_pb2.SessionEvent(event_seq=2, edit_prompts=edit))
    assert isinstance(event, SetPrompts)
    assert event.remove == (7,)
    assert (event.upsert[0].start_frame, event.upsert[0].end_frame) == (None, None)


QUARTER_TURN = [math.cos(math.pi / 4), 0.0, math.sin(math.pi / 4), 0.0]
"""About +Y, from +Z to +X."""


def test_waypoint_trajectory_joint_targets_and_keyframe_arrive() -> None:
    upsert = [
        motion_pb2.Constraint(constraint_id=1, frame=8, waypoint=motion_pb2.Waypoint(x=1, z=2, heading=0.5)),
        motion_pb2.Constraint(
            constraint_id=2, frame=9, root_trajectory=motion_pb2.RootTrajectory(positions=[1, 2, 3, 4], headings=[0, 1])
        ),
        motion_pb2.Constraint(
            constraint_id=3,
            frame=10,
            joint_targets=motion_pb2.JointTargets(joints=[0], positions=[1, 2, 3], rotations=QUARTER_TURN),
        ),
        motion_pb2.Constraint(constraint_id=4, frame=11, keyframe=motion_pb2.Keyframe(positions=[4, 5, 6])),
    ]
    edit = session_pb2.EditConstraints(upsert=upsert, remove=[8], clear=True)
    event = convert(session_pb2.SessionEvent(event_seq=2, edit_constraints=edit))
    assert isinstance(event, SetConstraints)
    assert (event.remove, event.clear) == ((8,), True)
    root, path, joints, pose = event.upsert
    assert root == Waypoint(1, 8, 1.0, 2.0, 0.5)
    assert isinstance(path, RootTrajectory)
    assert isinstance(joints, JointTargets)
    assert isinstance(pose, Keyframe)
    assert (path.first_frame, path.last_frame, path.xz.tolist()) == (9, 10, [[1, 2], [3, 4]])
    assert path.heading is not None
    assert path.heading.tolist() == [0, 1]
    assert (joints.constraint_id, joints.frame, joints.joints) == (3, 10, (0,))
    assert joints.rotations is not None
    np.testing.assert_allclose(joints.rotations[0] @ [0, 0, 1], [1, 0, 0], atol=1e-6)
    assert joints.positions.tolist() == [[1, 2, 3]]
    assert (pose.constraint_id, pose.frame, pose.positions.tolist()) == (4, 11, [[4, 5, 6]])


def test_heading_joint_rotations_and_root_path_arrive() -> None:
    upsert = [
        motion_pb2.Constraint(constraint_id=1, frame=8, heading=motion_pb2.HeadingTarget(heading=-0.5)),
        motion_pb2.Constraint(
            constraint_id=2, frame=9, joint_rotations=motion_pb2.JointRotations(joints=[0], rotations=QUARTER_TURN)
        ),
        motion_pb2.Constraint(constraint_id=3, root_path=motion_pb2.RootPath(positions=[1, 2, 3, 4])),
    ]
    edit = session_pb2.EditConstraints(upsert=upsert)
    event = convert(session_pb2.SessionEvent(event_seq=2, edit_constraints=edit))
    assert isinstance(event, SetConstraints)
    heading, turn, way = event.upsert
    assert isinstance(heading, HeadingTarget)
    assert (heading.constraint_id, heading.frame, heading.heading) == (1, 8, -0.5)
    assert isinstance(turn, JointRotations)
    assert (turn.constraint_id, turn.frame, turn.joints) == (2, 9, (0,))
    np.testing.assert_allclose(turn.rotations[0] @ [0, 0, 1], [1, 0, 0], atol=1e-6)
    assert isinstance(way, Unplaced)
    assert isinstance(way.target, RootPath)
    assert (way.target.constraint_id, way.target.corners.tolist()) == (3, [[1, 2], [3, 4]])


@pytest.mark.parametrize("heading", [7.0, -100.5, 1e7, -3.4e38])
def test_a_heading_of_many_turns_arrives_as_the_same_direction(heading: float) -> None:
    waypoint = motion_pb2.Waypoint(heading=heading)
    path = motion_pb2.RootTrajectory(positions=[0, 0, 0, 0], headings=[0.5, heading])
    upsert = [
        motion_pb2.Constraint(constraint_id=1, waypoint=waypoint),
        motion_pb2.Constraint(constraint_id=2, root_trajectory=path),
    ]
    edit = session_pb2.EditConstraints(upsert=upsert)
    event = convert(session_pb2.SessionEvent(event_seq=2, edit_constraints=edit))
    assert isinstance(event, SetConstraints)
    place, way = event.upsert
    assert isinstance(place, Waypoint)
    assert isinstance(way, RootTrajectory)
    assert place.heading is not None
    assert way.heading is not None
    wanted = math.fmod(waypoint.heading, math.tau)  # as float32 has it
    assert abs(place.heading) < math.tau
    assert (place.heading, way.heading[0], way.heading[1]) == pytest.approx((wanted, 0.5, wanted))


def test_playhead_play_state_and_close_arrive() -> None:
    report = session_pb2.Playhead(frame=5, buffered_to=40, underruns=2)
    assert convert(session_pb2.SessionEvent(playhead=report)) == Playhead(KEY, 0, 12.5, 5, 40, 2)
    paused = session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED)
    event = convert(session_pb2.SessionEvent(event_seq=3, set_play_state=paused))
    assert event == SetPlayState(KEY, 3, 12.5, PlayState.PAUSED)
    assert convert(session_pb2.SessionEvent(event_seq=4, close=session_pb2.CloseSession())) == Close(KEY, 4, 12.5)


@pytest.mark.parametrize(("heading", "expected"), [(None, None), (0.0, 0.0), (1.5, 1.5)])
def test_velocity_arrives_and_heading_0_differs_from_no_heading(heading: float | None, expected: float | None) -> None:
    velocity = session_pb2.SetVelocity(x=1.5, z=-2, heading=heading, hold_frames=20)
    event = convert(session_pb2.SessionEvent(event_seq=5, set_velocity=velocity))
    assert event == SetVelocity(KEY, 5, 12.5, 1.5, -2.0, expected, 20)


@pytest.mark.parametrize(
    ("velocity", "reason", "field"),
    [
        (session_pb2.SetVelocity(x=math.nan, hold_frames=1), "NOT_FINITE", "set_velocity.x"),
        (session_pb2.SetVelocity(z=math.inf, hold_frames=1), "NOT_FINITE", "set_velocity.z"),
        (session_pb2.SetVelocity(heading=math.nan, hold_frames=1), "NOT_FINITE", "set_velocity.heading"),
        (session_pb2.SetVelocity(x=8, z=7, hold_frames=1), "SPEED_OUT_OF_RANGE", "set_velocity"),
        (session_pb2.SetVelocity(x=1), "HOLD_OUT_OF_RANGE", "set_velocity.hold_frames"),
        (session_pb2.SetVelocity(x=1, hold_frames=401), "HOLD_OUT_OF_RANGE", "set_velocity.hold_frames"),
    ],
)
def test_invalid_velocity_is_refused(velocity: session_pb2.SetVelocity, reason: str, field: str) -> None:
    refusal = attempt(session_pb2.SessionEvent(event_seq=5, set_velocity=velocity))
    assert isinstance(refusal, EventRefused)
    assert (refusal.code, refusal.reason, refusal.field) == (Code.INVALID_ARGUMENT, reason, field)


def test_the_greatest_speed_is_allowed_in_any_direction() -> None:
    for angle in np.linspace(0, math.tau, 50):
        x, z = MAX_SPEED_MPS * math.sin(angle), MAX_SPEED_MPS * math.cos(angle)
        convert(session_pb2.SessionEvent(set_velocity=session_pb2.SetVelocity(x=x, z=z, hold_frames=1)))


@pytest.mark.parametrize(
    ("told", "expected"),
    [
        (None, None),
        (Duration(nanos=250_000_000), 0.25),
        (Duration(seconds=2**62), 1.0),
        (Duration(seconds=-(2**62), nanos=-(2**31)), 0.0),
    ],
)
def test_a_round_trip_is_bounded_whatever_the_client_says(told: Duration | None, expected: float | None) -> None:
    assert round_trip_s(service_pb2.Ping(round_trip=told)) == expected


# ---- outputs --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("effective", [None, 0, 44])
def test_effective_frame_0_differs_from_no_effective_frame(effective: int | None) -> None:
    outcome = updated(Outcome(KEY, 3, Code.OK, effective)).outcome
    assert outcome.HasField("effective_frame") == (effective is not None)
    assert outcome.effective_frame == (effective or 0)


@pytest.mark.parametrize(("retry_after_s", "nanos"), [(None, None), (0.25, 250_000_000), (0.0, 1_000_000)])
def test_refusal_carries_retry_after_if_the_engine_gave_one(retry_after_s: float | None, nanos: int | None) -> None:
    refusal = Outcome(KEY, 1, Code.RESOURCE_EXHAUSTED, reason="FULL", retry_after_s=retry_after_s)
    outcome = updated(refusal).outcome
    assert outcome.HasField("retry_after") == (nanos is not None)
    assert (outcome.retry_after.seconds, outcome.retry_after.nanos) == (0, nanos or 0)


def test_opened_service_level_and_closed_are_converted() -> None:
    opened = updated(Opened(KEY, 2**64 - 1, 0, 40, 4, 5, "tiny", "stick", 25))
    assert (opened.opened.seed, opened.opened.lookahead_frames) == (2**64 - 1, 40)
    assert (opened.opened.rig_id, opened.opened.model_id, opened.opened.frame_rate) == ("stick", "tiny", 25)
    level = updated(ServiceLevel(KEY, ServiceTier.FEWER_STEPS, 3)).service_level
    assert (level.tier, level.denoise_steps) == (session_pb2.SERVICE_TIER_FEWER_STEPS, 3)
    closed = updated(Closed(KEY, CloseReason.IDLE, Code.OK, "quiet", 120, 3)).closed
    assert (closed.reason, closed.message) == (session_pb2.CLOSE_REASON_IDLE, "quiet")
    assert (closed.frames, closed.late_frames) == (120, 3)


@pytest.mark.parametrize(
    ("ours", "prefix", "theirs"),
    [
        (Priority, "PRIORITY_CLASS_", session_pb2.PriorityClass),
        (PlanCause, "PLAN_CAUSE_", session_pb2.PlanCause),
        (PlayState, "PLAY_STATE_", session_pb2.PlayState),
        (CloseReason, "CLOSE_REASON_", session_pb2.CloseReason),
        (ServiceTier, "SERVICE_TIER_", session_pb2.ServiceTier),
    ],
)
def test_engine_enums_equal_those_of_the_protocol(ours: type, prefix: str, theirs: object) -> None:
    told = {f"{prefix}{each.name}": each.value for each in ours}  # type: ignore[attr-defined]
    offered = dict(theirs.items())  # type: ignore[attr-defined]
    offered.pop(f"{prefix}UNSPECIFIED")
    assert told == offered
