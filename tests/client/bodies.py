"""Bodies for tests of the client: Core-27 as a rig, and motion of it by formula."""

from __future__ import annotations

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton, load_skeleton
from motiongen_client import Motion, Rig
from motiongen_client.kinematics import axis_angle_to_quaternion

FPS = 20


def client_rig(name: str = "core27") -> Rig:
    """A rig of ours as the catalogue has it."""
    skeleton: Skeleton = load_skeleton(name)
    joints = skeleton.num_joints
    return Rig(
        rig_id=name,
        joint_names=skeleton.joint_names,
        parents=skeleton.parents,
        offsets_m=skeleton.offsets.astype(np.float32),
        frame_rate_hz=FPS,
        blocks={"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * joints, "foot_contact": 4},
        hip_joints=skeleton.hip_joints,
        limbs={"LeftFoot": skeleton.left_foot, "RightFoot": skeleton.right_foot},
    )


def swaying(rig: Rig, frames: int = 40, most_rad: float = 0.6) -> Motion:
    """Every joint sways about an axis of its own while the root goes ahead and turns."""
    generator, time = np.random.default_rng(11), np.arange(frames)[:, None, None] / FPS
    axes = generator.normal(size=(rig.num_joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = most_rad * np.sin(2 * time + generator.uniform(0, 6, (rig.num_joints, 1)))
    turns = axis_angle_to_quaternion(angles * axes)
    rows = np.zeros((frames, rig.row_width), np.float32)
    rows[:, :3] = np.array([0.3, 0.93, -0.2]) + time[:, 0] * [0.4, 0.02, 1.1]
    rows[:, 3:-4] = turns.reshape(frames, -1)
    return Motion(rig, 0, rows)
