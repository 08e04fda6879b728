"""What a session begins with: the length of its windows' history, and the frames before its first."""

from __future__ import annotations

import numpy as np

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Float32Array, ModelFacts
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import check_coordinates, check_finite, refuse

ROOT_WIDTH, QUATERNION_WIDTH = 3, 4
UNIT_TOLERANCE = 1e-2


def history_frames_of(
    message: session_pb2.OpenSession | session_pb2.SetOptions, facts: ModelFacts, field: str
) -> int | None:
    """The history of a session's windows, None if it is not given. field: the message's. Raises EventRefused."""
    if not message.HasField("history_frames"):
        return None
    asked, patch = message.history_frames, facts.patch
    most = facts.max_history // patch * patch
    if asked % patch or not patch <= asked <= most:
        allowed = f"multiples of {patch} from {patch} to {most}"
        raise refuse("HISTORY_OUT_OF_RANGE", f"{field}.history_frames", f"history_frames is {asked}", allowed)
    return asked


def prior_rows_of(
    message: session_pb2.OpenSession | session_pb2.Seek, catalog: Catalog, name: str = "open"
) -> Float32Array | None:
    """The frames (H, row_width) before frame 0, None if there are none. name: the event's. Raises EventRefused."""
    if not message.HasField("prior_frames"):
        return None
    field, prior, facts = f"{name}.prior_frames", message.prior_frames, catalog.facts
    if message.HasField("start_pose"):
        given, allowed = "there are prior frames too, which say where the character is", "one of the two"
        raise refuse("AMBIGUOUS_START", f"{name}.start_pose", given, allowed)
    most = catalog.limits.max_trajectory_frames
    count, patch, width = prior.frame_count, facts.patch, facts.row_width
    if count % patch or not patch <= count <= most:
        allowed = f"multiples of {patch} from {patch} to {most // patch * patch}"
        raise refuse("PRIOR_FRAMES_OUT_OF_RANGE", f"{field}.frame_count", f"there are {count} frames", allowed)
    if prior.scalar_type not in (motion_pb2.SCALAR_TYPE_UNSPECIFIED, motion_pb2.SCALAR_TYPE_F32_LE):
        given = f"scalar type {prior.scalar_type} is not supported here"
        raise refuse("INVALID_SCALAR_TYPE", f"{field}.scalar_type", given, "F32_LE")
    if len(prior.data) != 4 * count * width:
        allowed = f"{4 * count * width} bytes, {width} numbers of 4 bytes for each of {count} frames"
        raise refuse("WRONG_LENGTH", f"{field}.data", f"there are {len(prior.data)} bytes", allowed)
    rows = np.frombuffer(prior.data, "<f4").reshape(count, width).astype(np.float32)
    check_finite(rows, f"{field}.data", "finite numbers")
    _check_rows(rows, len(facts.rig.joint_names), f"{field}.data")
    return rows


def _check_rows(rows: Float32Array, num_joints: int, field: str) -> None:
    """Check coordinates and quaternions, and normalize the quaternions in place. Raises EventRefused."""
    check_coordinates(rows[:, :ROOT_WIDTH].ravel(), field)
    end = ROOT_WIDTH + QUATERNION_WIDTH * num_joints
    quaternions = rows[:, ROOT_WIDTH:end].reshape(len(rows), num_joints, QUATERNION_WIDTH).astype(np.float64)
    lengths = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    worst = float(np.abs(lengths - 1).max())
    if worst > UNIT_TOLERANCE:
        given, allowed = f"a quaternion's length is {worst:.3g} off 1", f"1 within {UNIT_TOLERANCE}"
        raise refuse("NOT_A_ROTATION", field, given, allowed)
    rows[:, ROOT_WIDTH:end] = (quaternions / lengths).reshape(len(rows), -1)
