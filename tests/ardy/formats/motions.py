"""Motion to write and read again."""

from __future__ import annotations

import numpy as np
import torch

from ardy.formats.stored import StoredMotion, from_pose
from ardy.rotation import axis_angle_to_matrix, matrix_to_quaternion
from ardy.skeleton import Skeleton
from motiongen_client.motion import Motion, Rig


def random_motion(skeleton: Skeleton, num_frames: int, seed: int, fps: int = 20, size: float = 0.7) -> StoredMotion:
    """A motion in which every joint turns smoothly, `size` radians or so, and the root walks about and spins."""
    random = torch.Generator().manual_seed(seed)
    time_s = torch.arange(num_frames, dtype=torch.float64)[:, None, None] / fps
    shape = (1, skeleton.num_joints, 3)
    phase, rate = (torch.rand(shape, generator=random, dtype=torch.float64) * 6 for _ in range(2))
    vectors = size * torch.sin(phase + rate * time_s)
    vectors[:, 0, 1] += 2 * time_s[:, 0, 0]
    root = torch.randn(1, 3, generator=random, dtype=torch.float64) + time_s[:, 0] * torch.tensor([0.5, 0.01, 1.2])
    return from_pose(skeleton, axis_angle_to_matrix(vectors), root, fps, "random motion", "a test")


def client_motion(stored: StoredMotion) -> Motion:
    """The same motion as the client holds it."""
    skeleton, motion = stored.skeleton, stored.motion
    joints = skeleton.num_joints
    blocks = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * joints, "foot_contact": 4}
    offsets = skeleton.offsets.astype(np.float32)
    rig = Rig(skeleton.name, skeleton.joint_names, skeleton.parents, offsets, motion.fps, blocks)
    quaternions = matrix_to_quaternion(motion.local_rotations).flatten(1)
    rows = torch.cat([motion.root_positions, quaternions, motion.foot_contacts.float()], dim=1)
    return Motion(rig, 0, rows.numpy())
