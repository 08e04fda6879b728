"""NPZ files with the arrays that NVIDIA's ARDY and Kimodo write and their tools read.

local_rot_mats and global_rot_mats (T, J, 3, 3), posed_joints (T, J, 3), root_positions and smooth_root_pos (T, 3),
foot_contacts (T, 4) bool, global_root_heading (T, 2) as cosine and sine, fps, text.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import (
    facing_rad,
    forward_kinematics,
    heading_rad,
    matrix_to_quaternion,
    quaternion_to_matrix,
)
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Float32, Motion, Rig
from motiongen_tools.whole_file import whole_file

_READ = ("local_rot_mats", "root_positions", "fps")
_ORTHOGONAL_WITHIN = 1e-2


def write_ardy_npz(path: Path | str, motion: Motion, text: str = "") -> None:
    """Write a motion with all of these arrays. text: the prompt."""
    rig, root = motion.rig, motion.root_translation_m.astype(np.float32)
    quaternions = motion.joint_rotation_quat_wxyz.astype(np.float64)
    positions, rotations = forward_kinematics(rig.parents, rig.offsets_m, root.astype(np.float64), quaternions)
    facing = heading_rad(rotations[:, 0]) if rig.hip_joints is None else facing_rad(positions, rig.hip_joints)
    with whole_file(path) as part, part.open("wb") as file:
        np.savez(
            file,
            local_rot_mats=quaternion_to_matrix(quaternions).astype(np.float32),
            global_rot_mats=rotations.astype(np.float32),
            posed_joints=positions.astype(np.float32),
            root_positions=root,
            smooth_root_pos=root,
            foot_contacts=motion.foot_contact > 0.5,
            global_root_heading=np.stack([np.cos(facing), np.sin(facing)], axis=-1).astype(np.float32),
            fps=np.asarray(rig.frame_rate_hz),
            text=np.asarray(text),
        )


def read_ardy_npz(path: Path | str, rig: Rig) -> Motion:
    """Read a motion of a rig. Raises InvalidInput for another kind of file, rig or frame rate."""
    with np.load(path, allow_pickle=False) as data:
        missing = [name for name in _READ if name not in data]
        if missing:
            raise InvalidInput("path", str(path), f"a file with {', '.join(_READ)}; {', '.join(missing)} missing")
        local, root = data["local_rot_mats"], data["root_positions"]
        fps = float(data["fps"])
        contacts = data["foot_contacts"] if "foot_contacts" in data else np.zeros((len(root), 4))
    shape = (len(root), rig.num_joints, 3, 3)
    if local.shape != shape or root.shape != (len(root), 3) or contacts.shape != (len(root), 4):
        given = f"local_rot_mats {local.shape} and root_positions {root.shape}"
        raise InvalidInput("path", given, f"motion of {rig.rig_id}, which has {rig.num_joints} joints")
    if fps != rig.frame_rate_hz:
        raise InvalidInput("path", f"{fps:g} frames a second", f"{rig.frame_rate_hz}, the rate of {rig.rig_id}")
    product = local @ np.swapaxes(local, -1, -2)
    if not (np.isfinite(root).all() and np.abs(product - np.eye(3)).max(initial=0) <= _ORTHOGONAL_WITHIN):
        raise InvalidInput("path", "matrices that are no rotations, or numbers that are not finite", "rotations")
    return Motion(rig, 0, _rows(rig, root, matrix_to_quaternion(local), contacts))


def _rows(rig: Rig, root: Float32, quaternions: np.ndarray, contacts: np.ndarray) -> Float32:
    rows = np.zeros((len(root), rig.row_width), np.float32)
    for name, values in ((ROOT_BLOCK, root), (ROTATION_BLOCK, quaternions), (CONTACT_BLOCK, contacts)):
        rows[:, rig.block_columns[name]] = values.reshape(len(root), -1)
    return rows
