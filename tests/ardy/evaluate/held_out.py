"""A small synthetic held-out split, and settings that evaluate little of it."""

from __future__ import annotations

from dataclasses import replace

import torch

from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.evaluate.context import Size
from tests.ardy.train.clips import swinging_clip, swinging_dataset

FEW = Size(seeds=1, moving=1, standing=1, sessions=2, matched=4, long_s=8, long_sessions=1)


def held_out() -> MotionDataset:
    """Two clips that walk on and two that stay where they are, long enough for every part of the evaluation."""
    clips = [swinging_clip(number, 200) for number in range(4)]
    stays = torch.tensor([0.0, 0.97, 0.0]).expand(200, 3)
    clips[0], clips[2] = (replace(clip, root_positions=stays) for clip in (clips[0], clips[2]))
    return replace(swinging_dataset(), clips=tuple(replace(clip, split="test") for clip in clips))
