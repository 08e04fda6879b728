"""A small synthetic data set: figures that walk while swinging their limbs."""

from __future__ import annotations

import torch

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.dataset import Clip, MotionDataset


def swinging_clip(number: int, num_frames: int) -> Clip:
    """A clip whose legs and arms swing at a rate that depends on its number, and whose root moves along +Z."""
    skeleton = load_skeleton("core27")
    seconds = torch.arange(num_frames) / 20
    angle = 0.5 * torch.sin((4 + number) * seconds)
    rotations = torch.zeros(num_frames, 27, 4)
    rotations[..., 0] = 1
    for name, sign in (("LeftUpLeg", 1), ("RightUpLeg", -1), ("LeftArm", -1), ("RightArm", 1)):
        joint = skeleton.index(name)
        rotations[:, joint, 0] = torch.cos(sign * angle / 2)
        rotations[:, joint, 1] = torch.sin(sign * angle / 2)
    root = torch.stack([torch.zeros(num_frames), torch.full((num_frames,), 0.97), seconds], dim=-1)
    return Clip(
        id=f"swing-{number}",
        dataset="formula",
        content="walk" if number % 2 else "stand",
        style="normal",
        split="train",
        captions=("a person walks with the left hand", "walk"),
        segments=(),
        mirror_allowed=number % 2 == 1,
        derived_from="",
        flags=(),
        figures={},
        local_rotations=rotations,
        root_positions=root,
    )


def swinging_dataset() -> MotionDataset:
    """Clips from 12 frames (too short to be used) to 160."""
    lengths = (12, 16, 30, 44, 90, 160)
    clips = tuple(swinging_clip(number, length) for number, length in enumerate(lengths))
    return MotionDataset(load_skeleton("core27"), 20.0, clips)
