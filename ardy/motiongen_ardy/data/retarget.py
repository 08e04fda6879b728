"""Applies a retarget description: from a BVH clip to local rotations and root positions of our skeleton.

Let G(j) be the global rotation of source joint j, and T(j) the world directions of its own axes (as columns) in the
neutral pose. Then the target joint k that it drives has the global rotation G(k) = G(j) T(j)^T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix, slerp
from motiongen_ardy.core.skeleton import global_to_local, positions_from_global
from motiongen_ardy.data.bvh import Bvh, axis_rotation
from motiongen_ardy.data.resample import resample
from motiongen_ardy.data.retarget_file import DIRECTIONS
from motiongen_ardy.data.retarget_rules import FixedGround, JointRule, LegScale, MeasuredGround, Retarget, RetargetError


@dataclass(frozen=True, eq=False)
class RetargetedClip:
    """A clip on our skeleton, float64. local_rotations: (T, J, 4) as (w, x, y, z); root_positions: (T, 3) metres.

    source_feet_m: (T, F, 3) metres, the source's foot joints from the description's `feet`, unscaled.
    """

    local_rotations: Tensor
    root_positions: Tensor
    source_feet_m: Tensor


def choose_retarget(bvh: Bvh, retargets: tuple[Retarget, ...]) -> Retarget:
    """The first retarget whose source joints the file has. Raises RetargetError if none fits."""
    missing = []
    for retarget in retargets:
        absent = sorted(retarget.source_joints.difference(bvh.joint_names))
        if not absent:
            return retarget
        missing.append(f"{retarget.name} needs {', '.join(absent)}")
    raise RetargetError(f"no retarget fits these joints: {'; '.join(missing)}")


def apply_retarget(retarget: Retarget, bvh: Bvh, fps: float, group: str = "") -> RetargetedClip:
    """Transfer a BVH clip to the retarget's skeleton, at `fps`. group: the clip's rest group, "" for none.

    Raises RetargetError if the file lacks a source joint.
    """
    choose_retarget(bvh, (retarget,))
    source_rotations, source_positions = resample(*bvh.global_pose(), bvh.fps, fps)
    values = retarget.values_for(group)
    index = {name: joint for joint, name in enumerate(bvh.joint_names)}
    rotations = _target_rotations(retarget, source_rotations, index, values)
    positions = _root_positions(retarget, bvh, rotations, source_positions, index, values)
    local = matrix_to_quaternion(global_to_local(retarget.skeleton, rotations))
    feet = [index[source] for source, _ in retarget.feet]
    return RetargetedClip(_continuous(local), positions, source_positions[:, feet] * retarget.metres_per_unit)


def neutral_axes(rule: JointRule, values: dict[str, float]) -> Tensor:
    """T(j), (3, 3): its columns are the world directions of the source joint's own axes in the neutral pose."""
    axes = torch.tensor([DIRECTIONS[axis] for axis in rule.axes], dtype=torch.float64).T
    if rule.turn is None:
        return axes
    about, degrees = rule.turn
    direction = DIRECTIONS[about]
    angle = math.radians(values[degrees] if isinstance(degrees, str) else degrees) * sum(direction)
    axis = [abs(part) for part in direction].index(1)
    return axis_rotation(axis, torch.tensor(angle, dtype=torch.float64)) @ axes


def _target_rotations(
    retarget: Retarget, source_rotations: Tensor, index: dict[str, int], values: dict[str, float]
) -> Tensor:
    """Global rotations (T, J, 3, 3) of the target skeleton."""
    by_name: dict[str, Tensor] = {}
    for name, rule in retarget.joints.items():
        by_name[name] = source_rotations[:, index[rule.source]] @ neutral_axes(rule, values).T
    for name, fill in retarget.between.items():
        start, end = matrix_to_quaternion(by_name[fill.start]), matrix_to_quaternion(by_name[fill.end])
        fraction = torch.full(start.shape[:1], fill.fraction, dtype=start.dtype)
        by_name[name] = quaternion_to_matrix(slerp(start, end, fraction))
    skeleton = retarget.skeleton
    for name, parent in zip(skeleton.joint_names, skeleton.parents, strict=True):
        if name in retarget.identity:
            by_name[name] = by_name[skeleton.joint_names[parent]]
    return torch.stack([by_name[name] for name in skeleton.joint_names], dim=1)


def _root_positions(
    retarget: Retarget,
    bvh: Bvh,
    rotations: Tensor,
    source_positions: Tensor,
    index: dict[str, int],
    values: dict[str, float],
) -> Tensor:
    """Root positions (T, 3), metres."""
    skeleton = retarget.skeleton
    unit = retarget.metres_per_unit
    scale = retarget.scale if isinstance(retarget.scale, float) else _leg_scale(retarget, retarget.scale, bvh)
    source = source_positions[:, [index[name] for name in retarget.root_source]].mean(dim=1) * unit
    ground = retarget.ground
    if isinstance(ground, FixedGround):
        height = values[ground.source_height] if isinstance(ground.source_height, str) else ground.source_height
        wanted = scale * (source - source.new_tensor([0.0, height * unit, 0.0]))
        wanted = wanted + source.new_tensor([0.0, ground.height_m, 0.0])
    else:
        wanted = scale * source
    bodies = positions_from_global(skeleton, rotations, torch.zeros_like(source))
    targets = [skeleton.index(name) for name in retarget.root_target]
    positions = wanted - bodies[:, targets].mean(dim=1)
    if isinstance(ground, MeasuredGround):
        joints = [skeleton.index(name) for name in ground.joints]
        lowest = (bodies[:, joints, 1] + positions[:, None, 1]).amin(dim=1)
        shift = ground.height_m - torch.quantile(lowest, ground.percentile / 100)
        positions = positions + torch.stack([torch.zeros_like(shift), shift, torch.zeros_like(shift)])
    return positions


def _leg_scale(retarget: Retarget, scale: LegScale, bvh: Bvh) -> float:
    lengths = dict(zip(bvh.joint_names, np.linalg.norm(bvh.offsets, axis=1), strict=True))
    skeleton = retarget.skeleton
    ours = dict(zip(skeleton.joint_names, np.linalg.norm(skeleton.offsets, axis=1), strict=True))
    # A chain starts at its first joint; its bones are the offsets of the joints after it.
    source = float(np.mean([sum(lengths[name] for name in chain[1:]) for chain in scale.source]))
    target = float(np.mean([sum(ours[name] for name in chain[1:]) for chain in scale.target]))
    if source <= 0:
        raise RetargetError(f"the chains of root.scale.from have no length in this file: {scale.source}")
    return target / (source * retarget.metres_per_unit)


def _continuous(quaternions: Tensor) -> Tensor:
    """The same rotations (T, J, 4) with signs chosen so that no quaternion flips between frames."""
    dots = (quaternions[1:] * quaternions[:-1]).sum(-1)
    signs = torch.where(dots < 0, -1.0, 1.0).cumprod(dim=0)
    first = torch.where(quaternions[:1, :, 0] < 0, -1.0, 1.0)
    return quaternions * torch.cat([first, first * signs])[..., None]
