"""Synthetic walks and stands for tests: T-posed bodies whose feet are planted by the code under test."""

from __future__ import annotations

import numpy as np
import torch

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.data.dataset import Clip
from motiongen_ardy.data.poses import Poses
from motiongen_ardy.data.replant import replant

CORE = load_skeleton("core27")
FPS = 20.0
HEIGHT_M = 0.965
PERIOD = 20
STANCE = 12


def sliding(frames: int, speed_m_s: float) -> Poses:
    """A stiff body carried along +Z, with the contacts of a walk (both feet stand when it does not move)."""
    quaternions = np.zeros((frames, CORE.num_joints, 4))
    quaternions[..., 0] = 1
    root = np.zeros((frames, 3))
    root[:, 1] = HEIGHT_M
    root[:, 2] = np.arange(frames) * speed_m_s / FPS
    time = np.arange(frames)
    left, right = time % PERIOD < STANCE, (time + PERIOD // 2) % PERIOD < STANCE
    contacts = np.repeat(np.stack([left, right], axis=-1)[..., None], 2, axis=-1)
    return Poses(quaternions, root, contacts if speed_m_s else np.ones_like(contacts))


def walking(frames: int = 120, speed_m_s: float = 1.0) -> Poses:
    return replant(CORE, sliding(frames, speed_m_s)).poses


def standing(frames: int = 60) -> Poses:
    return replant(CORE, sliding(frames, 0.0)).poses


def clip(poses: Poses, content: str, number: int, style: str = "normal", split: str = "train") -> Clip:
    return Clip(
        id=f"dataset-9_{content}_{style}_{number:03d}",
        dataset="dataset-9",
        content=content,
        style=style,
        split=split,
        captions=(f"a person does {content}",),
        segments=(),
        mirror_allowed=True,
        derived_from="",
        flags=(),
        figures={},
        local_rotations=torch.from_numpy(poses.quaternions).float(),
        root_positions=torch.from_numpy(poses.root).float(),
    )
