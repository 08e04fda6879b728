"""Motion as NPZ with the array names of ARDY's command line, which related tools read as well.

local_rot_mats and global_rot_mats (T, J, 3, 3), posed_joints (T, J, 3), root_positions (T, 3), smooth_root_pos (T, 3),
foot_contacts (T, 4), global_root_heading (T, 2) as cos and sin, fps, text. Metres, +Y up; see docs/formats.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.representation import heading_angle
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.formats.arrays import as_contacts, as_float32, read_arrays
from motiongen_ardy.formats.bounded import MAX_FRAMES
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.stored import StoredMotion, as_array, from_pose, skeleton_of_size, whole_fps

POSITION_WITHIN_M = 0.02

_READ = {
    "local_rot_mats": "f", "root_positions": "f", "posed_joints": "f", "foot_contacts": "bfiu", "fps": "fiu",
    "text": "U",
}  # fmt: skip
_SHAPES: dict[str, tuple[int | None, ...]] = {
    "local_rot_mats": (None, None, 3, 3), "root_positions": (None, 3), "posed_joints": (None, None, 3),
    "foot_contacts": (None, 4), "fps": (), "text": (),
}  # fmt: skip
_MAX_JOINTS = 256


def write_npz(path: Path, stored: StoredMotion) -> None:
    """Write a motion with all arrays named above."""
    motion = stored.motion
    local, root_positions = motion.local_rotations.double(), motion.root_positions.double()
    rotations, positions = forward_kinematics(stored.skeleton, local, root_positions)
    heading = heading_angle(stored.skeleton, positions)
    root = as_array(root_positions).astype(np.float32)
    with written_whole(path) as partial, partial.open("wb") as file:
        np.savez(
            file,
            local_rot_mats=as_array(local).astype(np.float32),
            global_rot_mats=as_array(rotations).astype(np.float32),
            posed_joints=as_array(positions).astype(np.float32),
            root_positions=root,
            smooth_root_pos=root,
            foot_contacts=as_array(motion.foot_contacts) > 0.5,
            global_root_heading=as_array(torch.stack([heading.cos(), heading.sin()], dim=-1)).astype(np.float32),
            fps=np.asarray(motion.fps),
            text=np.asarray(stored.text),
        )


def read_npz(path: Path, skeleton: Skeleton | None = None) -> StoredMotion:
    """Read local_rot_mats, root_positions and fps, and foot_contacts and text if present.

    Unless given, the skeleton is the one with as many joints. Raises FormatError if a required array is missing or has
    another shape, and if posed_joints do not match the skeleton's bones (the file then has another skeleton).
    """
    arrays = read_arrays(path, _READ, lambda name, shape: _check_shape(path, name, shape))
    for name in ("local_rot_mats", "root_positions", "fps"):
        if name not in arrays:
            raise FormatError(path, f"{name} is missing", f"the file has {', '.join(arrays) or 'none of the names'}")
    text = str(arrays["text"]) if "text" in arrays else ""
    rotations = as_float32(arrays["local_rot_mats"])
    root = as_float32(arrays["root_positions"])
    skeleton = skeleton_of_size(path, rotations.shape[1], skeleton)
    contacts = None
    if "foot_contacts" in arrays:
        contacts = as_contacts(path, "foot_contacts", arrays["foot_contacts"])
    fps = whole_fps(path, float(arrays["fps"]))
    lengths = {name: len(arrays[name]) for name in arrays if arrays[name].ndim}
    if len(set(lengths.values())) > 1:
        raise FormatError(path, f"arrays of different lengths: {lengths}", "every array has one entry a frame")
    stored = from_pose(skeleton, rotations, root, fps, source=path, text=text, contacts=contacts)
    if "posed_joints" in arrays:
        _check_positions(path, stored, as_float32(arrays["posed_joints"]))
    return stored


def _check_shape(path: Path, name: str, shape: tuple[int, ...]) -> None:
    wanted = _SHAPES[name]
    if len(shape) != len(wanted) or any(w is not None and s != w for s, w in zip(shape, wanted, strict=True)):
        letters = ["frames", "joints"]
        said = ", ".join(str(letters[axis]) if length is None else str(length) for axis, length in enumerate(wanted))
        raise FormatError(path, f"{name} has shape {str(shape)[:60]}", f"({said}) is wanted, one motion a file")
    if shape and not (1 <= shape[0] <= MAX_FRAMES and (len(shape) < 3 or shape[1] <= _MAX_JOINTS)):
        raise FormatError(
            path, f"{name} has shape {str(shape)[:60]}", f"at most {MAX_FRAMES} frames of {_MAX_JOINTS} joints"
        )


def _check_positions(path: Path, stored: StoredMotion, positions: torch.Tensor) -> None:
    expected = stored.positions()
    if positions.shape != expected.shape:
        raise FormatError(path, f"posed_joints of shape {tuple(positions.shape)}", f"give {tuple(expected.shape)}")
    error = (positions - expected).norm(dim=-1)
    if not error.isfinite().all() or float(error.max()) > POSITION_WITHIN_M:
        frame, joint = divmod(int(error.nan_to_num(torch.inf).argmax()), error.shape[1])
        given = f"joint {joint} in frame {frame} is not where the bones of {stored.skeleton.name} put it"
        raise FormatError(path, given, f"positions and rotations must agree to {100 * POSITION_WITHIN_M:.0f} cm")
