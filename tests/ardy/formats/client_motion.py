"""Motion as the Python client represents it."""

from __future__ import annotations

import numpy as np
import torch

from motiongen_ardy.core.rotation import matrix_to_quaternion
from motiongen_ardy.formats.stored import StoredMotion
from motiongen_client.motion import Motion, Rig


def client_motion(stored: StoredMotion) -> Motion:
    """The same motion in the client's representation."""
    skeleton, motion = stored.skeleton, stored.motion
    joints = skeleton.num_joints
    blocks = {"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * joints, "foot_contact": 4}
    offsets = skeleton.offsets.astype(np.float32)
    rig = Rig(skeleton.name, skeleton.joint_names, skeleton.parents, offsets, motion.fps, blocks)
    quaternions = matrix_to_quaternion(motion.local_rotations).flatten(1)
    rows = torch.cat([motion.root_positions, quaternions, motion.foot_contacts.float()], dim=1)
    return Motion(rig, 0, rows.numpy())
