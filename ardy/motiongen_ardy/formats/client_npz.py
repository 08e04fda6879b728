"""Motion as NPZ written by the Python client (`motiongen stream --out walk.npz`): frame rows by block, and the rig.

root_translation_m (T, 3), joint_rotation_quat_wxyz (T, J, 4), foot_contact (T, 4), joint_names (J), frame_rate_hz.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.formats.arrays import as_contacts, read_arrays
from motiongen_ardy.formats.bounded import MAX_FRAMES
from motiongen_ardy.formats.errors import FormatError, shortened
from motiongen_ardy.formats.stored import StoredMotion, from_pose, skeleton_with, whole_fps

MARK = "joint_rotation_quat_wxyz"  # the array that distinguishes this form from ARDY's own
UNIT_WITHIN = 0.01

_READ = {
    "root_translation_m": "f", MARK: "f", "foot_contact": "f", "joint_names": "U", "frame_rate_hz": "iu",
}  # fmt: skip
_DIMENSIONS = {"root_translation_m": 2, MARK: 3, "foot_contact": 2, "joint_names": 1, "frame_rate_hz": 0}
_MAX_JOINTS = 256


def read_client_npz(path: Path, skeleton: Skeleton | None = None) -> StoredMotion:
    """Read a motion that the client wrote, with one of our skeletons. Raises FormatError."""

    def check(name: str, shape: tuple[int, ...]) -> None:
        most = _MAX_JOINTS if name == "joint_names" else MAX_FRAMES
        if len(shape) != _DIMENSIONS[name] or any(length > most for length in shape):
            given = f"{name} has shape {str(shape)[:60]}"
            raise FormatError(path, given, f"{_DIMENSIONS[name]} axes of at most {most} are wanted")

    arrays = read_arrays(path, _READ, check)
    missing = [name for name in _READ if name not in arrays]
    if missing:
        raise FormatError(path, f"{', '.join(missing)} missing", f"the client writes {', '.join(_READ)}")
    names = [str(name) for name in arrays["joint_names"]]
    skeleton = skeleton_with(path, names, skeleton)
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise FormatError(path, f"joint_names has {shortened(twice)} twice", "name each joint once")
    quaternions = torch.from_numpy(arrays[MARK].astype(np.float64))
    num_frames = len(quaternions)
    for name, shape in (
        (MARK, (num_frames, len(names), 4)),
        ("root_translation_m", (num_frames, 3)),
        ("foot_contact", (num_frames, 4)),
    ):
        if arrays[name].shape != shape:
            raise FormatError(path, f"{name} has shape {arrays[name].shape}", f"{shape} goes with the other arrays")
    length = quaternions.norm(dim=-1)
    if not bool(((length - 1).abs() <= UNIT_WITHIN).all()):
        raise FormatError(path, f"{MARK} are not all of length 1", "give unit quaternions w, x, y, z")
    rotations = quaternion_to_matrix(quaternions[:, [names.index(name) for name in skeleton.joint_names]])
    root = torch.from_numpy(arrays["root_translation_m"].astype(np.float64))
    contacts = as_contacts(path, "foot_contact", arrays["foot_contact"])
    fps = whole_fps(path, float(arrays["frame_rate_hz"]))
    return from_pose(skeleton, rotations, root, fps, source=path, contacts=contacts)
