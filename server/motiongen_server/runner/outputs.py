"""Outputs on request: further blocks of frame rows, computed from the rows themselves on the host.

Velocities at a frame are from the frame before to this one. The sign of a world quaternion is that of the product of
the local ones on its chain: their signs are continuous from frame to frame, so it is too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.robot.rows import QPOS_WIDTH, QVEL_WIDTH, qpos_of_rows, qvel_between
from motiongen_server.engine.types import ChannelBlock, Float32Array

ROBOT_RIG = "g134"

JOINT_POSITIONS = "joint_positions_m"
GLOBAL_ROTATIONS = "joint_global_rotation_quat_wxyz"
JOINT_VELOCITIES = "joint_velocities_mps"
G1_QPOS = "g1_qpos"
G1_QVEL = "g1_qvel"


def output_blocks(skeleton: Skeleton) -> tuple[ChannelBlock, ...]:
    """The blocks that can be asked for with motion on a skeleton."""
    joints = skeleton.num_joints
    blocks = (
        ChannelBlock(JOINT_POSITIONS, 3 * joints),
        ChannelBlock(GLOBAL_ROTATIONS, 4 * joints),
        ChannelBlock(JOINT_VELOCITIES, 3 * joints),
    )
    robot = (ChannelBlock(G1_QPOS, QPOS_WIDTH), ChannelBlock(G1_QVEL, QVEL_WIDTH))
    return (*blocks, *robot) if skeleton.name == ROBOT_RIG else blocks


def outputs_of_rows(skeleton: Skeleton, fps: int, names: Sequence[str], rows: Float32Array) -> Float32Array:
    """(T - 1, W) float32 for rows (T, row_width), of which the first is the frame before the others."""
    made = [_MAKERS[name](skeleton, fps, torch.from_numpy(np.ascontiguousarray(rows)).double()) for name in names]
    outputs: Float32Array = torch.cat(made, dim=1).float().numpy()
    return outputs


def _turns(skeleton: Skeleton, rows: Tensor) -> Tensor:
    """(T, J, 4): rotations relative to the parent."""
    return rows[:, 3 : 3 + 4 * skeleton.num_joints].reshape(len(rows), -1, 4)


def _places(skeleton: Skeleton, rows: Tensor) -> Tensor:
    """(T, J, 3) world metres."""
    _, positions = forward_kinematics(skeleton, quaternion_to_matrix(_turns(skeleton, rows)), rows[:, :3])
    return positions


def _positions(skeleton: Skeleton, fps: int, rows: Tensor) -> Tensor:
    return _places(skeleton, rows[1:]).flatten(1)


def _velocities(skeleton: Skeleton, fps: int, rows: Tensor) -> Tensor:
    places = _places(skeleton, rows).flatten(1)
    moved: Tensor = (places[1:] - places[:-1]) * fps
    return moved


def _global_rotations(skeleton: Skeleton, fps: int, rows: Tensor) -> Tensor:
    local = _turns(skeleton, rows[1:]).unbind(1)
    found = [local[0]]
    for joint in range(1, skeleton.num_joints):
        found.append(_product(found[skeleton.parents[joint]], local[joint]))
    return torch.nn.functional.normalize(torch.stack(found, dim=1), dim=-1).flatten(1)


def _product(first: Tensor, second: Tensor) -> Tensor:
    """(..., 4) w x y z: the rotation `second` followed by `first`."""
    w, v, u, x = first[..., :1], first[..., 1:], second[..., :1], second[..., 1:]
    scalar = w * u - (v * x).sum(-1, keepdim=True)
    return torch.cat([scalar, w * x + u * v + torch.linalg.cross(v, x)], dim=-1)


def _qpos(skeleton: Skeleton, fps: int, rows: Tensor) -> Tensor:
    return qpos_of_rows(_turns(skeleton, rows[1:]), rows[1:, :3])


def _qvel(skeleton: Skeleton, fps: int, rows: Tensor) -> Tensor:
    return qvel_between(qpos_of_rows(_turns(skeleton, rows), rows[:, :3]), fps)


_MAKERS: Mapping[str, Callable[[Skeleton, int, Tensor], Tensor]] = {
    JOINT_POSITIONS: _positions,
    GLOBAL_ROTATIONS: _global_rotations,
    JOINT_VELOCITIES: _velocities,
    G1_QPOS: _qpos,
    G1_QVEL: _qvel,
}
