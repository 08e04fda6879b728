"""Captures as a user would have them: BVH files of the Core-27 rig, a retarget file for it, and a table of labels."""

from __future__ import annotations

from pathlib import Path

import torch

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.bvh import write_bvh
from motiongen_ardy.formats.stored import StoredMotion
from tests.ardy.train.clips import swinging_clip

CORE = load_skeleton("core27")
HEADER = "id,file,content,style,split,texts"


def write_capture(path: Path, number: int = 0, num_frames: int = 40) -> Path:
    """A BVH file of a figure that swings its limbs."""
    clip = swinging_clip(number, num_frames)
    contacts = torch.zeros(num_frames, 4, dtype=torch.bool)
    motion = Motion(quaternion_to_matrix(clip.local_rotations), clip.root_positions, contacts, 20)
    write_bvh(path, StoredMotion(CORE, motion))
    return path


def write_retarget(path: Path, feet: str = "") -> Path:
    """A retarget file whose source is the Core-27 rig, in centimetres."""
    joints = "\n".join(f"  {name}: {{from: {name}}}" for name in CORE.joint_names)
    root = CORE.joint_names[0]
    path.write_text(
        f"name: own\nskeleton: core27\nmetres_per_unit: 0.01\njoints:\n{joints}\n"
        f"root: {{from: [{root}], to: [{root}], scale: 1.0, ground: {{source_height: 0, height: 0}}}}\n{feet}"
    )
    return path


def write_table(path: Path, *rows: str) -> Path:
    """A table of labels, with the texts in the last column."""
    path.write_text("\n".join((HEADER, *rows, "")))
    return path
