"""Plants feet: every stance of a synthetic motion stays in one place, and swings lead from one stance to the next.

The raw motion carries the body correctly, but its feet slide. In each stance, the slide of the standing joint is
removed; the correction is zero half way through the stance, so that a step lands where the body passes over it. In
swings, the correction changes smoothly from one stance to the next. Legs follow by the two-bone solution, and the
pelvis is lowered where a leg would be too short.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import torch

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.leg import MAX_REACH, solve_leg
from motiongen_ardy.data.poses import Poses, continuous, global_pose, quaternions_of, runs, smooth, yaw_matrix, yaw_of

MIN_STANCE_FRAMES = 2
CLEARANCE_M = 0.045
# A stance of at least this many frames is standing; the steps before and after it are lifted by at least this.
STANDING_FRAMES = 26
FIRST_LIFT_M = 0.06
# The speed of the correction at the ends of a swing is kept, up to this, metres a frame.
MAX_SLOPE_M = 0.04


@dataclass(frozen=True)
class Replanted:
    """The motion with planted feet, and two figures, both (T,) metres.

    drop_m: how far the pelvis was lowered; short_m: by how much an ankle misses its goal.
    """

    poses: Poses
    drop_m: np.ndarray
    short_m: np.ndarray


def replant(
    skeleton: Skeleton, raw: Poses, flatten: np.ndarray | None = None, widen: np.ndarray | None = None
) -> Replanted:
    """Plant the feet of a raw motion according to its contacts.

    flatten: (T,) 0..1, how far feet are turned flat and low (small steps have no push-off). widen: (T,), metres by
    which each foot is moved outwards, so that feet do not cross in sideways steps.
    """
    frames = raw.num_frames
    flatten = np.zeros(frames) if flatten is None else flatten
    widen = np.zeros(frames) if widen is None else widen
    rotations, positions = global_pose(skeleton, raw.quaternions, raw.root)
    across = positions[:, skeleton.hip_joints[1]] - positions[:, skeleton.hip_joints[0]]
    across[:, 1] = 0
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    goals, feet = [], []
    for side, chain in enumerate((skeleton.left_foot, skeleton.right_foot)):
        ankle = positions[:, chain[0]] + (1 - 2 * side) * widen[:, None] * across
        goal, foot = _plant(ankle, rotations[:, chain[0]], skeleton.offsets[chain[1]], raw.contacts[:, side], flatten)
        goals.append(goal)
        feet.append(foot)
    return _solve(skeleton, raw, rotations, positions, goals=goals, feet=feet, flatten=flatten)


def _plant(
    ankle: np.ndarray, foot: np.ndarray, toe_bone: np.ndarray, contacts: np.ndarray, flatten: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Goals (T, 3) of one ankle and rotations (T, 3, 3) of its foot."""
    ankle = ankle.copy()
    stances = [span for span in runs(contacts.any(-1)) if span[1] - span[0] >= MIN_STANCE_FRAMES]
    yaw = yaw_of(foot)
    if flatten.any():
        rest = np.quantile(ankle[:, 1], 0.1)
        ankle[:, 1] += flatten * (rest - ankle[:, 1])
        foot = _flattened(foot, yaw, flatten)
    yaw_steps = np.diff(yaw)
    turn = _correction(yaw_steps[:, None], stances, np.inf)[:, 0]
    foot = yaw_matrix(turn) @ foot
    toe = ankle + foot @ toe_bone
    # The toe base stands from when it is down; before that the heel stands, to which the ankle is the nearest joint.
    on_toe = (contacts[1:, 1] & contacts[:-1, 1]) | ~contacts[1:, 0]
    steps = np.where(on_toe[:, None], np.diff(toe, axis=0), np.diff(ankle, axis=0))[:, [0, 2]]
    ankle[:, [0, 2]] += _correction(steps, stances, MAX_SLOPE_M)
    _clear(ankle, foot @ toe_bone, stances)
    return ankle, foot


def _flattened(foot: np.ndarray, yaw: np.ndarray, share: np.ndarray) -> np.ndarray:
    level = continuous(quaternions_of(yaw_matrix(yaw)[:, None]))[:, 0]
    tilted = quaternions_of(foot)
    tilted = np.where((tilted * level).sum(-1, keepdims=True) < 0, -tilted, tilted)
    mixed = (1 - share[:, None]) * tilted + share[:, None] * level
    return quaternion_to_matrix(torch.from_numpy(mixed)).numpy()


def _correction(steps: np.ndarray, stances: list[tuple[int, int]], max_slope: float) -> np.ndarray:
    """The correction (T, C) with which nothing moves within a stance. steps: (T - 1, C), changes of the raw value."""
    frames = len(steps) + 1
    change = np.zeros((frames, steps.shape[1]))
    if not stances:
        return change
    for start, end in stances:
        total = np.concatenate([np.zeros((1, steps.shape[1])), -np.cumsum(steps[start : end - 1], axis=0)])
        change[start:end] = total - total[(end - start) // 2]
    change[: stances[0][0]] = change[stances[0][0]]
    change[stances[-1][1] :] = change[stances[-1][1] - 1]
    for (_, end), (start, _) in itertools.pairwise(stances):
        length = start - end + 1
        part = (np.arange(1, length) / length)[:, None]
        leave = np.clip(-steps[max(end - 2, 0)], -max_slope, max_slope) * length
        arrive = np.clip(-steps[min(start, len(steps) - 1)], -max_slope, max_slope) * length
        change[end:start] = (
            (1 + 2 * part) * (1 - part) ** 2 * change[end - 1]
            + part * (1 - part) ** 2 * leave
            + part**2 * (3 - 2 * part) * change[start]
            + part**2 * (part - 1) * arrive
        )
    return change


def _clear(ankle: np.ndarray, toe: np.ndarray, stances: list[tuple[int, int]]) -> None:
    """Lift swings that would drag, and keep toes and ankles above the ground (in place)."""
    low_toe, low_ankle = 0.008, 0.055
    for (before, end), (start, after) in itertools.pairwise(stances):
        if start - end < 2:
            continue
        part = np.arange(1, start - end + 1) / (start - end + 1)
        travel = np.linalg.norm(ankle[start, [0, 2]] - ankle[end - 1, [0, 2]])
        raised = (ankle[end:start, 1] + toe[end:start, 1]).max() - min(ankle[end - 1, 1] + toe[end - 1, 1], 0.03)
        missing = min(CLEARANCE_M, 0.02 + 0.2 * travel) - raised
        if missing > 0:
            ankle[end:start, 1] += missing * np.sin(np.pi * part)
        if max(end - before, after - start) >= STANDING_FRAMES and travel > 0.05:
            # A foot that leaves a standing pose or joins one rises at once, before the body has moved on.
            floor = ankle[end - 1, 1] + part * (ankle[start, 1] - ankle[end - 1, 1])
            floor += FIRST_LIFT_M * np.sin(np.pi * part) ** 0.8
            ankle[end:start, 1] = np.maximum(ankle[end:start, 1], floor)
    ankle[:, 1] = np.maximum(ankle[:, 1], np.maximum(low_ankle, low_toe - toe[:, 1]))


def _solve(
    skeleton: Skeleton,
    raw: Poses,
    rotations: np.ndarray,
    positions: np.ndarray,
    *,
    goals: list[np.ndarray],
    feet: list[np.ndarray],
    flatten: np.ndarray,
) -> Replanted:
    """Bend the legs so that each ankle is at its goal (T, 3) and its foot is turned as in feet (T, 3, 3); left, right.

    rotations, positions: of the raw motion's joints, in the world.
    """
    chains = []
    for chain, hip in zip((skeleton.left_foot, skeleton.right_foot), skeleton.hip_joints[::-1], strict=True):
        knee = skeleton.parents[chain[0]]
        chains.append((hip, knee, chain[0], chain[1]))
    drop = np.zeros(raw.num_frames)
    for (hip, knee, ankle, _), goal in zip(chains, goals, strict=True):
        length = (np.linalg.norm(skeleton.offsets[knee]) + np.linalg.norm(skeleton.offsets[ankle])) * MAX_REACH
        flat = np.linalg.norm((goal - positions[:, hip])[:, [0, 2]], axis=-1)
        lowest = goal[:, 1] + np.sqrt(np.maximum(length**2 - flat**2, 0))
        drop = np.maximum(drop, positions[:, hip, 1] - lowest)
    drop = _dilated(np.maximum(drop, 0), 3)
    drop = np.maximum(smooth(drop, 2.0), 0)
    root = raw.root - np.array([0.0, 1.0, 0.0]) * drop[:, None]
    quaternions = raw.quaternions.copy()
    short = np.zeros(raw.num_frames)
    for (hip, knee, ankle, toe), goal, foot in zip(chains, goals, feet, strict=True):
        hips = positions[:, hip] - np.array([0.0, 1.0, 0.0]) * drop[:, None]
        leg = solve_leg(
            hips, goal, rotations[:, hip], rotations[:, knee], skeleton.offsets[knee], skeleton.offsets[ankle]
        )
        pelvis = rotations[:, skeleton.parents[hip]]
        quaternions[:, hip] = quaternions_of(np.swapaxes(pelvis, -1, -2) @ leg.thigh)
        quaternions[:, knee] = quaternions_of(np.swapaxes(leg.thigh, -1, -2) @ leg.shin)
        quaternions[:, ankle] = quaternions_of(np.swapaxes(leg.shin, -1, -2) @ foot)
        bend = quaternions[:, toe] * np.sign(quaternions[:, toe, :1] + 1e-12)
        bend = (1 - flatten[:, None]) * bend + flatten[:, None] * np.array([1.0, 0, 0, 0])
        quaternions[:, toe] = bend / np.linalg.norm(bend, axis=-1, keepdims=True)
        short = np.maximum(short, leg.short_m)
    return Replanted(Poses(continuous(quaternions), root, raw.contacts), drop, short)


def _dilated(values: np.ndarray, reach: int) -> np.ndarray:
    padded = np.pad(values, reach, mode="edge")
    return np.max([padded[shift : shift + len(values)] for shift in range(2 * reach + 1)], axis=0)
