"""Conversion of messages to types and back, and rigs and chunks that are inconsistent."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import (
    EventRefused,
    JointTargets,
    Keyframe,
    Outcome,
    ProtocolViolation,
    Rig,
    RootTrajectory,
    SessionOptions,
    UnknownName,
    Waypoint,
    convert,
)
from tests.client.synthetic import ROW_WIDTH, catalog, rig, synthetic_rows


def test_catalogue_finds_models_and_rigs_by_name_and_has_limits() -> None:
    offered = convert.catalog(catalog(20))
    assert offered.model("synthetic").horizon_frames == 40
    assert offered.rig("stick9").row_width == ROW_WIDTH
    assert offered.limits.max_prompts == 4
    with pytest.raises(UnknownName, match="no model is called 'big'; known are: synthetic"):
        offered.model("big")
    with pytest.raises(UnknownName, match="stick9"):
        offered.rig("core27")


def test_unknown_blocks_of_a_rig_are_skipped_by_their_width() -> None:
    message = rig(20)
    message.blocks.insert(1, motion_pb2.ChannelBlock(name="something_new", width=5))
    assert convert.rig(message).block_columns["joint_rotation_quat_wxyz"].start == 8


@pytest.mark.parametrize(
    ("spoil", "complaint"),
    [
        (lambda message: message.blocks.pop(1), "joint_rotation_quat_wxyz has width None, not 36"),
        (lambda message: message.parents.pop(), "9 joints, but 8 parents"),
        (lambda message: message.neutral_offsets_m.pop(), "26 offset numbers"),
        (lambda message: message.parents.__setitem__(2, 5), "no tree"),
        (lambda message: message.parents.__setitem__(2, -1), "no tree"),
        (lambda message: setattr(message, "frame_rate", 0), "frame rate 0"),
    ],
)
def test_inconsistent_rig_is_a_protocol_violation(spoil: object, complaint: str) -> None:
    message = rig(20)
    spoil(message)  # type: ignore[operator]
    with pytest.raises(ProtocolViolation, match=complaint):
        convert.rig(message)


def chunk(**fields: object) -> motion_pb2.FrameChunk:
    values = {
        "frame_count": 3,
        "data": synthetic_rows(1, 5, 3).astype("<f4").tobytes(),
        "scalar_type": motion_pb2.SCALAR_TYPE_F32_LE,
    }
    return motion_pb2.FrameChunk(**{**values, **fields})  # type: ignore[arg-type]


def test_chunks_become_rows(stick_rig: Rig) -> None:
    rows = convert.FrameReader(stick_rig).rows(chunk())
    assert rows.dtype == np.float32
    np.testing.assert_array_equal(rows, synthetic_rows(1, 5, 3))


@pytest.mark.parametrize("fields", [{"frame_count": 4}, {"frame_count": 0, "data": b""}, {"scalar_type": 0}])
def test_chunk_of_a_wrong_size_or_type_is_a_protocol_violation(stick_rig: Rig, fields: dict[str, object]) -> None:
    with pytest.raises(ProtocolViolation, match="a chunk"):
        convert.FrameReader(stick_rig).rows(chunk(**fields))


def test_constraints_become_messages() -> None:
    waypoint = convert.constraint(1, Waypoint(30, 1.5, -2, heading_rad=0.25))
    assert (waypoint.frame, waypoint.waypoint.x, waypoint.waypoint.z, waypoint.waypoint.heading) == (30, 1.5, -2, 0.25)
    assert not convert.constraint(1, Waypoint(30, 1, 2)).waypoint.HasField("heading")
    path = convert.constraint(2, RootTrajectory(10, np.array([[1, 2], [3, 4]]), np.array([0, 1])))
    assert (path.frame, list(path.root_trajectory.positions)) == (10, [1, 2, 3, 4])
    assert list(path.root_trajectory.headings) == [0, 1]
    pose = convert.constraint(3, Keyframe(9, np.arange(6).reshape(2, 3)))
    assert list(pose.keyframe.positions) == [0, 1, 2, 3, 4, 5]
    hands = convert.constraint(4, JointTargets(9, [0, 4], np.zeros((2, 3)), np.eye(4)[:2]))
    assert list(hands.joint_targets.joints) == [0, 4]
    assert list(hands.joint_targets.rotations) == [1, 0, 0, 0, 0, 1, 0, 0]


def test_options_that_were_not_given_are_absent_from_the_message() -> None:
    message = convert.open_session(SessionOptions(), [], [])
    absent = ("seed", "start_pose", "denoise_steps", "guidance")
    assert not any(message.HasField(name) for name in absent)  # type: ignore[arg-type]
    assert (message.rig_id, message.model_id, message.lookahead_frames) == ("", "", 0)
    assert not message.keep_prompts
    assert convert.open_session(SessionOptions(keep_prompts=True), [], []).keep_prompts
    zero = convert.open_session(SessionOptions(seed=0, text_guidance=0.0), [], [])
    assert zero.HasField("seed")
    assert zero.guidance.HasField("text")


def test_outcome_messages_become_outcomes_or_refusals() -> None:
    accepted = session_pb2.EditOutcome(event_seq=3, effective_frame=0)
    assert convert.outcome(accepted, "it") == Outcome(3, 0)
    assert convert.outcome(session_pb2.EditOutcome(event_seq=3), "it") == Outcome(3, None)
    refused = convert.outcome(session_pb2.EditOutcome(event_seq=3, code=99, message="why"), "it")
    assert isinstance(refused, EventRefused)
    assert str(refused) == "it was refused with 99: why"


def test_unknown_close_reason_is_read_as_unspecified() -> None:
    assert convert.session_end(session_pb2.SessionClosed(reason=77)).reason == "unspecified"  # type: ignore[arg-type]
    idle = session_pb2.SessionClosed(reason=session_pb2.CLOSE_REASON_IDLE, frames=9, late_frames=2)
    assert convert.session_end(idle).reason == "idle"
