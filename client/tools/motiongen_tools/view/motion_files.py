"""Reads a user's motion files, with the client's own reader or with the converter."""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Motion, Rig
from motiongen_tools.ardy_npz import read_ardy_npz
from motiongen_tools.conversion import convert_to_npz
from motiongen_tools.npz import read_npz

MAX_BYTES = 64 << 20
FOLDER_PREFIX = "motiongen-view-"
"""Prefix of the temporary folders in which files are read and written."""
MOST_FRAMES = 20_000
MOST_HZ = 1000
MOST_SIGNS = 60
"""Most characters of an uploaded name's suffixes that are kept: systems allow names of 255 bytes."""


def read_upload(name: str, data: bytes, rigs: Sequence[Rig]) -> Motion:
    """The motion in a file's bytes; the suffix of its name tells the format. rigs: those that the server knows.

    Raises InvalidInput or ConversionFailed.
    """
    suffixes = "".join(Path(name).suffixes[-2:]).lower().replace("\0", "")[-MOST_SIGNS:]
    if not data or not suffixes:
        raise InvalidInput("file", name or "nothing", "a motion file with a name, such as walk.bvh or walk.npz")
    with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX) as folder:
        source = Path(folder) / f"motion{suffixes}"
        source.write_bytes(data)
        motion = _read_own(source) if suffixes.endswith(".npz") else None
        if motion is None:
            converted = Path(folder) / "converted.npz"
            convert_to_npz(source, converted, source_name=name)
            motion = _read_converted(converted, rigs)
    if not 0 < len(motion) <= MOST_FRAMES:
        raise InvalidInput("file", f"{len(motion)} frames", f"1 to {MOST_FRAMES} frames")
    mistake = _mistake(motion)
    if mistake:
        raise InvalidInput("file", f"{name}: {mistake}", "a motion that a skeleton can have")
    return motion


def _mistake(motion: Motion) -> str:
    """Why the page could not draw a motion, "" if it can: files bring their own skeleton."""
    rig, joints = motion.rig, motion.rig.num_joints
    widths = {ROOT_BLOCK: 3, ROTATION_BLOCK: 4 * joints, CONTACT_BLOCK: 4}
    for name, width in widths.items():
        if rig.blocks.get(name) != width:
            return f"block {name} has width {rig.blocks.get(name)}, not {width}"
    if min(rig.blocks.values()) < 0:
        return "a block has a width below 0"
    if not joints or len(rig.parents) != joints or np.shape(rig.offsets_m) != (joints, 3):
        return f"{joints} joints, {len(rig.parents)} parents, offsets of shape {np.shape(rig.offsets_m)}"
    if any(not -1 <= parent < joint or (parent < 0) != (joint == 0) for joint, parent in enumerate(rig.parents)):
        return "its joints do not form a tree with parents first"
    if not 1 <= rig.frame_rate_hz <= MOST_HZ:
        return f"{rig.frame_rate_hz} frames a second, not 1 to {MOST_HZ}"
    for numbers in (rig.offsets_m, motion.rows):
        if not np.issubdtype(numbers.dtype, np.floating) or not np.isfinite(numbers).all():
            return "a number that is not finite"
    return ""


def _read_own(source: Path) -> Motion | None:
    """The motion of an NPZ file of motiongen; None if it comes from another tool."""
    try:
        return read_npz(source)
    except InvalidInput:
        return None


def _read_converted(path: Path, rigs: Sequence[Rig]) -> Motion:
    with np.load(path, allow_pickle=False) as data:
        num_joints, fps = data["local_rot_mats"].shape[1], float(data["fps"])
    for rig in rigs:
        if rig.num_joints == num_joints:
            return read_ardy_npz(path, dataclasses.replace(rig, frame_rate_hz=round(fps)))
    known = ", ".join(f"{rig.rig_id} ({rig.num_joints} joints)" for rig in rigs)
    raise InvalidInput("file", f"motion of {num_joints} joints", f"motion of the server's rigs: {known}")
