"""The Unitree G1: motion on the skeleton g134 <-> qpos, the rows that its simulators and controllers use.

A qpos row is 36 numbers: the root's position (x, y, z, metres), its quaternion (w, x, y, z), and 29 hinge angles in
radians in the order of `G1.hinges`. Its frame has Z up, +X forward and +Y to the left; ours has +Y up and +Z forward,
so [x, y, z] there is [z, x, y] here: p_robot = A p and R_robot = A R A^T with A = `TO_ROBOT`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from typing import Any

import torch
from torch import Tensor

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.representation import motion_from_pose
from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix, rotation_vector
from motiongen_ardy.core.skeleton import Skeleton, load_skeleton

QPOS_WIDTH = 36
TO_ROBOT = torch.tensor([[0, 0, 1], [1, 0, 0], [0, 1, 0]], dtype=torch.float64, device="cpu")


class RobotError(ValueError):
    """Raised for a robot state that is invalid; the message says what was given and what is allowed."""


@dataclass(frozen=True)
class Body:
    """One rigid body: its place on its parent (metres, quaternion w x y z), and the hinge that moves it.

    hinge: its name without "_joint", None for the root. axis: in the body's frame. lower, upper: radians.
    speed_limit: rad/s.
    """

    name: str
    parent: str | None
    position: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    hinge: str | None
    axis: tuple[float, float, float]
    lower: float
    upper: float
    speed_limit: float


@dataclass(frozen=True, eq=False)
class G1:
    """The robot's kinematics and the matching joints of the skeleton g134; all in the order of the hinges, float64.

    hinges: names. joints: index of each hinge's joint in the skeleton. fixed: (29, 3, 3), rotation of each body
    relative to its parent at angle 0. axes: (29, 3). lower, upper: (29), radians. speed_limits: (29), rad/s.
    """

    skeleton: Skeleton
    bodies: tuple[Body, ...]
    hinges: tuple[str, ...]
    joints: tuple[int, ...]
    fixed: Tensor
    axes: Tensor
    lower: Tensor
    upper: Tensor
    speed_limits: Tensor


@lru_cache
def load_g1() -> G1:
    """The content of `g1.json`, with hinges matched by name to the skeleton's joints."""
    facts = json.loads((resources.files("motiongen_ardy") / "robot" / "g1.json").read_text(encoding="utf-8"))
    bodies = tuple(_body(entry) for entry in facts["bodies"])
    moved = [body for body in bodies if body.hinge is not None]
    skeleton = load_skeleton("g134")

    def table(values: list[Any]) -> Tensor:
        return torch.tensor(values, dtype=torch.float64, device="cpu")

    with torch.inference_mode(False):  # tables first loaded while serving may be used in training later
        return G1(
            skeleton=skeleton,
            bodies=bodies,
            hinges=tuple(str(body.hinge) for body in moved),
            joints=tuple(skeleton.index(f"{body.hinge}_skel") for body in moved),
            fixed=quaternion_to_matrix(table([body.quaternion for body in moved])),
            axes=table([body.axis for body in moved]),
            lower=table([body.lower for body in moved]),
            upper=table([body.upper for body in moved]),
            speed_limits=table([body.speed_limit for body in moved]),
        )


def _body(entry: dict[str, Any]) -> Body:
    hinge = entry.get("hinge")
    x, y, z = hinge["axis"] if hinge else (0.0, 0.0, 0.0)
    return Body(
        name=entry["body"],
        parent=entry["parent"],
        position=tuple(entry["position_m"]),
        quaternion=tuple(entry["quaternion_wxyz"]),
        hinge=hinge["name"].removesuffix("_joint") if hinge else None,
        axis=(x, y, z),
        lower=hinge["range_rad"][0] if hinge else 0.0,
        upper=hinge["range_rad"][1] if hinge else 0.0,
        speed_limit=hinge["speed_limit_rad_s"] if hinge else 0.0,
    )


def hinge_matrix(axes: Tensor, angles: Tensor) -> Tensor:
    """Rotations (..., 3, 3) by angles (...) in radians about unit axes (..., 3), by Rodrigues' formula."""
    x, y, z = axes.expand(*angles.shape, 3).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))
    sine, cosine = torch.sin(angles)[..., None, None], torch.cos(angles)[..., None, None]
    return torch.eye(3, dtype=angles.dtype, device=angles.device) + sine * cross + (1 - cosine) * (cross @ cross)


def hinge_angles(local_rotations: Tensor) -> Tensor:
    """Angles (T, 29) float64 in (-pi, pi] from parent-relative rotations (T, 34, 3, 3) of the skeleton g134.

    Each is the angle of the rotation about the hinge's axis that is nearest to the joint's rotation without its body's
    fixed one.
    """
    robot = load_g1()
    local = local_rotations.double()[..., list(robot.joints), :, :]
    turn = robot.fixed.transpose(-1, -2) @ (TO_ROBOT @ local @ TO_ROBOT.T)
    # trace(R(angle)^T turn) is largest where its derivative with respect to the angle is 0
    twice_axis = torch.stack(
        [turn[..., 2, 1] - turn[..., 1, 2], turn[..., 0, 2] - turn[..., 2, 0], turn[..., 1, 0] - turn[..., 0, 1]], -1
    )
    along = torch.einsum("ji,...jik,jk->...j", robot.axes, turn, robot.axes)
    trace = turn.diagonal(dim1=-2, dim2=-1).sum(-1)
    return torch.atan2((twice_axis * robot.axes).sum(-1), trace - along)


def motion_to_qpos(motion: Motion) -> Tensor:
    """Qpos (T, 36) float64, on the CPU, of a motion with the skeleton g134 on any device.

    Each angle is that of the rotation about the hinge's axis nearest to the joint's rotation: exact for a rotation
    about that axis; any other rotation of the joint is lost (`lost_rotation` says how much). In (-pi, pi], not clamped.
    Raises RobotError for a motion with another skeleton.
    """
    robot = load_g1()
    num_joints = motion.local_rotations.shape[-3]
    if num_joints != robot.skeleton.num_joints:
        raise RobotError(f"the motion has {num_joints} joints; qpos is of {robot.skeleton.name}, which has 34")
    motion = motion.on_host()
    angles = hinge_angles(motion.local_rotations)
    root = TO_ROBOT @ motion.local_rotations.double()[..., 0, :, :] @ TO_ROBOT.T
    position = motion.root_positions.double() @ TO_ROBOT.T
    return torch.cat([position, matrix_to_quaternion(root), angles], dim=-1)


def lost_rotation(motion: Motion, qpos: Tensor) -> Tensor:
    """Radians (T, 34) by which each joint's rotation differs from that of qpos (T, 36); 0 for the root."""
    kept = qpos_to_local_rotations(qpos)
    difference = kept.transpose(-1, -2) @ motion.on_host().local_rotations.double()
    lost = rotation_vector(difference).norm(dim=-1)
    return torch.cat([torch.zeros_like(lost[..., :1]), lost[..., 1:]], dim=-1)


def qpos_to_local_rotations(qpos: Tensor) -> Tensor:
    """Parent-relative rotations (..., 34, 3, 3) float64, in our frame, of qpos rows (..., 36)."""
    robot = load_g1()
    qpos = qpos.double()
    hinges = robot.fixed @ hinge_matrix(robot.axes, qpos[..., 7:])
    root = quaternion_to_matrix(qpos[..., 3:7])
    identity = torch.eye(3, dtype=torch.float64, device=qpos.device)
    rotations = identity.repeat(*qpos.shape[:-1], robot.skeleton.num_joints, 1, 1)
    rotations[..., list(robot.joints), :, :] = TO_ROBOT.T @ hinges @ TO_ROBOT
    rotations[..., 0, :, :] = TO_ROBOT.T @ root @ TO_ROBOT
    return rotations


def check_qpos(qpos: Tensor) -> None:
    """Raise RobotError unless qpos is (T, 36), T at least 1, finite, with quaternions of length near 1."""
    if qpos.ndim != 2 or qpos.shape[1] != QPOS_WIDTH or not len(qpos):
        raise RobotError(f"qpos has shape {tuple(qpos.shape)}; give (frames, {QPOS_WIDTH}), one frame or more")
    bad = (~qpos.isfinite()).any(1).nonzero().flatten().tolist()
    if bad:
        raise RobotError(f"qpos row {bad[0]} holds NaN or infinite numbers; every one must be finite")
    length = qpos[:, 3:7].double().norm(dim=1)
    bad = ((length - 1).abs() > 0.01).nonzero().flatten().tolist()
    if bad:
        raise RobotError(
            f"the quaternion in row {bad[0]} of qpos has length {float(length[bad[0]]):.3g}; columns 3 to 6 are a unit"
            " quaternion w, x, y, z"
        )


def qpos_to_motion(qpos: Tensor, fps: int) -> Motion:
    """The motion (float64) of qpos rows (T, 36) at fps; foot contacts are computed as for the features.

    Joints without a hinge (toes, hands) keep the identity rotation. Raises RobotError as `check_qpos` does.
    """
    check_qpos(qpos)
    root = qpos[:, :3].double() @ TO_ROBOT
    return motion_from_pose(load_g1().skeleton, qpos_to_local_rotations(qpos), root, fps)
