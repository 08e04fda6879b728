"""Residuals: by how much motion misses its constraints, in metres and radians."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Floats, Targets
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.representation import heading_angle
from motiongen_ardy.core.rotation import rotation_vector
from motiongen_ardy.core.skeleton import forward_kinematics


@dataclass(frozen=True)
class Deviation:
    """The mean and the worst of one kind of error, over all frames and joints that were constrained."""

    mean: float
    worst: float


@dataclass(frozen=True)
class Residual:
    """The errors of one constraint; None where it asks for nothing of that kind within the motion.

    num_frames: how many of its frames are within the motion. position_m: distances of the root (over the ground only,
    unless a height is constrained) and of the constrained joints. heading_rad: of the heading, in 0..pi. rotation_rad:
    of the global rotations, in 0..pi.
    """

    num_frames: int
    position_m: Deviation | None
    heading_rad: Deviation | None
    rotation_rad: Deviation | None


def residuals(motion: Motion, constraints: Iterable[Targets], first_frame: int = 0) -> list[Residual]:
    """The residual of each constraint, given as its targets, in the order of `constraints`.

    motion: (T), with the targets' skeleton, on any device; its row 0 is frame first_frame. Each constraint is measured
    on its own: what a later constraint overrides counts too.
    """
    posed: tuple[Tensor, Tensor] | None = None
    measured = []
    for targets in constraints:
        if posed is None:
            motion = motion.on_host()  # targets are on the CPU
            local, root = motion.local_rotations.double(), motion.root_positions.double()
            posed = forward_kinematics(targets.skeleton, local, root)
        measured.append(_residual(targets, *posed, first_frame))
    return measured


def _residual(targets: Targets, rotations: Tensor, positions: Tensor, first_frame: int) -> Residual:
    """rotations: (T, J, 3, 3) global; positions: (T, J, 3) metres."""
    end = first_frame + len(positions)
    frames = [frame for frame in targets.frames if first_frame <= frame < end]
    there = set(frames)
    roots = [frame for frame in targets.ground if frame in there]
    joints = [(frame, joint) for frame, joint in targets.positions if joint and frame in there]
    turned = [key for key in targets.rotations if key[0] in there]
    facing = [frame for frame in targets.heading if frame in there]

    def found(values: Tensor, keys: list[tuple[int, int]]) -> Tensor:
        return values[[frame - first_frame for frame, _ in keys], [joint for _, joint in keys]]

    distances, headings, turns = [], [], []
    if roots:
        root = found(positions, [(frame, 0) for frame in roots])
        place = root.double().clone()
        place[:, [0, 2]] = _doubles([targets.ground[frame] for frame in roots])
        held = [row for row, frame in enumerate(roots) if frame in targets.height]
        place[held, 1] = _doubles([targets.height[roots[row]] for row in held])
        distances.append((root - place).norm(dim=-1))
    if joints:
        asked = _doubles([_asked_position(targets, *key) for key in joints])
        distances.append((found(positions, joints) - asked).norm(dim=-1))
    if facing:
        asked = _doubles([targets.heading[frame] for frame in facing])
        posed = heading_angle(targets.skeleton, positions[[frame - first_frame for frame in facing]])
        difference = posed - torch.atan2(asked[:, 1], asked[:, 0])
        headings.append(torch.atan2(difference.sin(), difference.cos()).abs())
    if turned:
        asked = _doubles([targets.rotations[key] for key in turned])
        turns.append(rotation_vector(asked.transpose(-1, -2) @ found(rotations, turned)).norm(dim=-1))
    return Residual(len(frames), _deviation(distances), _deviation(headings), _deviation(turns))


def _doubles(rows: Sequence[Floats | np.float32]) -> Tensor:
    return torch.from_numpy(np.array(rows, np.float64))


def _asked_position(targets: Targets, frame: int, joint: int) -> Floats:
    """A joint's target position (3), moved with the root if the root's target differs from the joint's pose."""
    position, root, ground = targets.positions[frame, joint], targets.root_of(frame, joint), targets.ground.get(frame)
    if root is None or ground is None:
        return position
    shift = ground - root
    return position + np.array([shift[0], 0.0, shift[1]], np.float32)


def _deviation(errors: Sequence[Tensor]) -> Deviation | None:
    if not errors:
        return None
    values = torch.cat(list(errors))
    return Deviation(float(values.mean()), float(values.max()))
