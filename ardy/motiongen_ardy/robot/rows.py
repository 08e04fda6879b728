"""Frames of a stream for a controller of the G1: a row's qpos is that of its frame, its qvel led there from the last.

`trajectory` does the same for a whole motion, in which the following rows are known.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.robot.g1 import QPOS_WIDTH, TO_ROBOT, hinge_angles
from motiongen_ardy.robot.trajectory import QVEL_WIDTH, clamp_to_range, relative_rotation

__all__ = ["QPOS_WIDTH", "QVEL_WIDTH", "qpos_of_rows", "qvel_between"]


def qpos_of_rows(quaternions: Tensor, root_positions: Tensor) -> Tensor:
    """Qpos (T, 36) float64, with every angle within its joint's range.

    quaternions: (T, 34, 4) of the skeleton g134, relative to the parent; root_positions: (T, 3) metres. The sign of the
    root's quaternion is kept.
    """
    quaternions = quaternions.double()
    root = torch.cat([quaternions[:, 0, :1], quaternions[:, 0, 1:] @ TO_ROBOT.T], dim=1)
    angles = hinge_angles(quaternion_to_matrix(quaternions))
    qpos, _ = clamp_to_range(torch.cat([root_positions.double() @ TO_ROBOT.T, root, angles], dim=1))
    return qpos


def qvel_between(qpos: Tensor, rate_hz: float) -> Tensor:
    """Qvel (T - 1, 35) that led to each row of qpos (T, 36) but the first, in MuJoCo's order (`JointTrajectory`).

    The root's angular velocity is in the root's axes at the previous row.
    """
    step = (qpos[1:] - qpos[:-1]) * rate_hz
    turn = relative_rotation(qpos[:-1, 3:7], qpos[1:, 3:7]) * rate_hz
    return torch.cat([step[:, :3], turn, step[:, 7:]], dim=1)
