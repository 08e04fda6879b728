"""Figures that judge a training set: bones, ground, planted feet, speeds, turns."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
import torch
from rich.markup import escape
from rich.table import Table
from torch import Tensor

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.data.dataset import Clip, MotionDataset


@dataclass(frozen=True)
class ClipFigures:
    """One clip. speed, forward and left: mean horizontal root velocity, m/s, the latter two in the heading frame.

    turn_deg: net heading change, + to the left. hand heights: the highest of each hand, metres. lowest_m: the height of
    the lowest joint. bone_error_m: the largest change of any bone's length.
    """

    content: str
    num_frames: int
    speed_m_s: float
    forward_m_s: float
    left_m_s: float
    turn_deg: float
    left_hand_m: float
    right_hand_m: float
    lowest_m: float
    bone_error_m: float
    norm_error: float


@dataclass(frozen=True)
class Verdict:
    """The result of one check of the whole set."""

    passed: bool
    text: str


@dataclass(frozen=True)
class SetFigures:
    """Figures by content, and the verdicts."""

    fps: float
    by_content: dict[str, list[ClipFigures]]
    verdicts: tuple[Verdict, ...]


def measure(dataset: MotionDataset) -> SetFigures:
    """Measure every clip and judge the set."""
    by_content: dict[str, list[ClipFigures]] = defaultdict(list)
    for clip in dataset.clips:
        by_content[clip.content].append(measure_clip(clip, dataset.skeleton, dataset.fps))
    return SetFigures(dataset.fps, dict(sorted(by_content.items())), _judge(dataset, by_content))


def measure_clip(clip: Clip, skeleton: Skeleton, fps: float) -> ClipFigures:
    """The figures of one clip, by forward kinematics in float64."""
    quaternions, root = clip.local_rotations.double(), clip.root_positions.double()
    _, positions = forward_kinematics(skeleton, quaternion_to_matrix(quaternions), root)
    right, left = skeleton.hip_joints
    across = positions[:, left] - positions[:, right]
    # The left hip line turned by -90 degrees about +Y points forward; heading 0 faces +Z.
    heading = torch.atan2(-across[:, 2], across[:, 0])
    velocity = (root[1:] - root[:-1]) * fps
    facing = torch.stack([torch.sin(heading), torch.cos(heading)], dim=-1)[:-1]
    forward = velocity[:, 0] * facing[:, 0] + velocity[:, 2] * facing[:, 1]
    sideways = velocity[:, 0] * facing[:, 1] - velocity[:, 2] * facing[:, 0]
    return ClipFigures(
        content=clip.content,
        num_frames=clip.num_frames,
        speed_m_s=float(velocity[:, [0, 2]].norm(dim=-1).mean()),
        forward_m_s=float(forward.mean()),
        left_m_s=float(sideways.mean()),
        turn_deg=math.degrees(_net_turn(heading)),
        left_hand_m=float(positions[:, skeleton.left_hand[0], 1].max()),
        right_hand_m=float(positions[:, skeleton.right_hand[0], 1].max()),
        lowest_m=float(positions[..., 1].min()),
        bone_error_m=_bone_error(skeleton, positions),
        norm_error=float((quaternions.norm(dim=-1) - 1).abs().max()),
    )


def _net_turn(heading: Tensor) -> float:
    steps = torch.diff(heading)
    return float(torch.atan2(torch.sin(steps), torch.cos(steps)).sum())


def _bone_error(skeleton: Skeleton, positions: Tensor) -> float:
    parents = list(skeleton.parents[1:])
    lengths = (positions[:, 1:] - positions[:, parents]).norm(dim=-1)
    return float((lengths - torch.tensor(skeleton.offsets[1:]).norm(dim=-1)).abs().max())


def _judge(dataset: MotionDataset, by_content: dict[str, list[ClipFigures]]) -> tuple[Verdict, ...]:
    every = [figures for group in by_content.values() for figures in group]
    bones = max(figures.bone_error_m for figures in every)
    norms = max(figures.norm_error for figures in every)
    verdicts = [
        Verdict(bones < 1e-4, f"bone lengths are constant: largest change {bones * 1000:.4f} mm (below 0.1)"),
        Verdict(norms < 1e-4, f"quaternions have length 1: largest error {norms:.1e} (below 1e-4)"),
    ]
    planted = [clip.figures for clip in dataset.clips if "planted_drift_m_s" in clip.figures]
    if planted:
        weights = np.array([entry["planted_frames"] for entry in planted])
        drift = _weighted_median(np.array([entry["planted_drift_m_s"] for entry in planted]), weights)
        height = _weighted_median(np.array([entry["planted_height_m"] for entry in planted]), weights)
        verdicts.append(
            Verdict(drift < 0.02, f"planted feet stay: median ankle drift {drift * 100:.2f} cm/s (below 2)")
        )
        verdicts.append(Verdict(0.05 < height < 0.1, f"median planted ankle height {height:.4f} m (0.05 to 0.1)"))
    for content, sign in (("walk-turn-left", 1), ("walk-turn-right", -1)):
        turns = [sign * figures.turn_deg for figures in by_content.get(content, ())]
        if turns:
            share = sum(turn > 0 for turn in turns) / len(turns)
            verdicts.append(Verdict(share > 0.95, f"{content} turns that way in {share:.1%} of its clips (above 95 %)"))
    for side, other in (("left", "right"), ("right", "left")):
        group = [f for kind in ("wave", "raise-up") for f in by_content.get(f"{kind}-{side}-hand", ())]
        if group:
            heights = {"left": [f.left_hand_m for f in group], "right": [f.right_hand_m for f in group]}
            share = float(np.mean(np.array(heights[side]) > np.array(heights[other])))
            verdicts.append(Verdict(share > 0.98, f"{side}-hand gestures raise that hand in {share:.1%} (above 98 %)"))
    return tuple(verdicts)


def _weighted_median(values: np.ndarray, weights: np.ndarray) -> float:
    order = np.argsort(values)
    total = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(total, total[-1] / 2)])


def figures_table(figures: SetFigures) -> Table:
    """One row for each content: medians over its clips."""
    table = Table(title="medians over the clips of each content; speeds m/s, heights m")
    table.add_column("content")
    columns = ("clips", "frames", "seconds", "speed", "forward", "left", "turn deg", "hands L / R", "lowest")
    for column in columns:
        table.add_column(column, justify="right")
    for content, group in figures.by_content.items():

        def middle(name: str, group: list[ClipFigures] = group) -> float:
            return float(np.median([getattr(entry, name) for entry in group]))

        table.add_row(
            escape(content),  # a word in brackets would be taken for a style of the table
            str(len(group)),
            str(sum(entry.num_frames for entry in group)),
            f"{middle('num_frames') / figures.fps:.1f}",
            f"{middle('speed_m_s'):.2f}",
            f"{middle('forward_m_s'):.2f}",
            f"{middle('left_m_s'):.2f}",
            f"{middle('turn_deg'):.0f}",
            f"{middle('left_hand_m'):.2f} / {middle('right_hand_m'):.2f}",
            f"{middle('lowest_m'):.3f}",
        )
    return table
