"""Motion to NPZ and back: named arrays, for numpy and everything that reads its files."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from motiongen_client.errors import InvalidInput
from motiongen_client.motion import Motion, Rig
from motiongen_tools.whole_file import whole_file

_FORMAT = "motiongen-motion-1"
MAX_BYTES = 512 << 20
"""Limit for all arrays of a file together when it is read: a small file can unpack to any number of zeros."""


def write_npz(path: Path | str, motion: Motion) -> None:
    """Write a motion and its rig.

    Arrays: root_translation_m (T, 3), joint_rotation_quat_wxyz (T, J, 4), foot_contact (T, 4), joint_positions_m
    (T, J, 3); joint_names, parents, offsets_m (J, 3), frame_rate_hz, first_frame, rig_id; block_names, block_widths
    and rows (T, D), from which `read_npz` makes the same motion again.
    """
    rig = motion.rig
    with whole_file(path) as part, part.open("wb") as file:
        np.savez_compressed(
            file,
            format=_FORMAT,
            root_translation_m=motion.root_translation_m,
            joint_rotation_quat_wxyz=motion.joint_rotation_quat_wxyz,
            foot_contact=motion.foot_contact,
            joint_positions_m=motion.joint_positions_m(),
            joint_names=np.array(rig.joint_names),
            parents=np.array(rig.parents),
            offsets_m=rig.offsets_m,
            frame_rate_hz=rig.frame_rate_hz,
            first_frame=motion.first_frame,
            rig_id=rig.rig_id,
            block_names=np.array(list(rig.blocks)),
            block_widths=np.array(list(rig.blocks.values())),
            rows=motion.rows,
        )


def read_npz(path: Path | str) -> Motion:
    """Read what `write_npz` wrote. Raises InvalidInput if it is something else, OSError if it does not exist."""
    allowed = f"a file of format {_FORMAT}, as write_npz makes it"
    try:
        return _read(path, allowed)
    except InvalidInput:
        raise
    except (ValueError, LookupError, TypeError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error) as error:
        raise InvalidInput("path", str(path), f"{allowed}: {error}") from None


def _read(path: Path | str, allowed: str) -> Motion:
    with zipfile.ZipFile(path) as packed:
        if sum(entry.file_size for entry in packed.infolist()) > MAX_BYTES:
            raise InvalidInput("path", str(path), f"arrays of at most {MAX_BYTES >> 20} MiB together")
    with Path(path).open("rb") as file, np.load(file, allow_pickle=False) as data:
        if "format" not in data or str(data["format"]) != _FORMAT:
            raise InvalidInput("path", str(path), allowed)
        widths = [int(width) for width in data["block_widths"]]
        rig = Rig(
            rig_id=str(data["rig_id"]),
            joint_names=tuple(str(name) for name in data["joint_names"]),
            parents=tuple(int(parent) for parent in data["parents"]),
            offsets_m=data["offsets_m"],
            frame_rate_hz=int(data["frame_rate_hz"]),
            blocks=dict(zip((str(name) for name in data["block_names"]), widths, strict=True)),
        )
        return Motion(rig, int(data["first_frame"]), data["rows"])
