"""Trajectories that a controller can follow: clamped angles, continuous quaternions, any rate, velocities, a clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.rotation import slerp
from motiongen_ardy.data.resample import resampled_length
from motiongen_ardy.robot.g1 import RobotError, check_qpos, load_g1, lost_rotation, motion_to_qpos

QVEL_WIDTH = 35
MAX_RATE_HZ = 10_000.0
MAX_ROWS = 2_000_000  # half an hour at 1000 Hz, and some gigabytes of memory
_LISTED = 5
_LOST_RAD = 0.01  # a lost rotation of less than half a degree is not worth reporting


@dataclass(frozen=True)
class Excess:
    """One joint beyond one limit: in how many of num_frames frames, and by how much at worst."""

    joint: str
    frames: int
    num_frames: int
    worst: float
    unit: str

    def __str__(self) -> str:
        return f"{self.joint} in {self.frames} of {self.num_frames} frames by up to {self.worst:.3g} {self.unit}"


@dataclass(frozen=True)
class TrajectoryReport:
    """What was changed or is wrong. clamped: angles beyond the range; too_fast: speeds beyond the joint's limit, after
    clamping; lost: rotation of the original motion that no hinge can reproduce.
    """

    clamped: tuple[Excess, ...] = ()
    too_fast: tuple[Excess, ...] = ()
    lost: tuple[Excess, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The report in words, the worst joints first; empty if nothing is wrong."""
        said = []
        for what, found in (
            ("angles clamped to the joint's range", self.clamped),
            ("joints faster than the robot's", self.too_fast),
            ("rotation lost that the hinges cannot do", self.lost),
        ):
            if found:
                worst = sorted(found, key=lambda one: one.worst, reverse=True)
                more = f"; and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
                said.append(f"{what}: {'; '.join(map(str, worst[:_LISTED]))}{more}")
        return tuple(said)


@dataclass(frozen=True, eq=False)
class JointTrajectory:
    """A series of states on one clock.

    time_s: (T). qpos: (T, 36). qvel: (T, 35), in MuJoCo's order: root velocity in the world (m/s), root angular
    velocity in the root's own frame (rad/s), hinges (rad/s); the qvel of a row leads from its qpos to the next row's in
    one period, and the last row repeats the one before it.
    """

    time_s: Tensor
    qpos: Tensor
    qvel: Tensor
    rate_hz: float


def clamp_to_range(qpos: Tensor) -> tuple[Tensor, tuple[Excess, ...]]:
    """Qpos (T, 36) with every angle within its joint's range, and which angles were beyond it.

    Angles are equivalent modulo a full turn: an angle beyond the range is moved to the end that is nearer on the
    circle, which keeps a joint that turns past +-pi from jumping across its range.
    """
    robot = load_g1()
    middle = (robot.lower + robot.upper) / 2
    turn = 2 * math.pi
    angles = middle + torch.remainder(qpos[:, 7:] - middle + math.pi, turn) - math.pi
    kept = torch.minimum(torch.maximum(angles, robot.lower), robot.upper)
    return torch.cat([qpos[:, :7], kept], dim=1), _excesses((angles - kept).abs(), robot.hinges, "rad", 1e-9)


def continuous_signs(quaternions: Tensor) -> Tensor:
    """Quaternions (T, 4) with signs such that each is within half a turn of the one before; the first has w >= 0."""
    flips = torch.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0).to(quaternions.dtype)
    first = torch.where(quaternions[:1, 0] < 0, -1.0, 1.0).to(quaternions.dtype)
    return quaternions * torch.cumprod(torch.cat([first, flips]), 0)[:, None]


def resample_qpos(qpos: Tensor, from_hz: float, to_hz: float) -> Tensor:
    """Qpos (T', 36) at another rate, from the same row 0 on: quaternions by slerp, all else linearly.

    Ends at or before the last row. Raises RobotError for a rate that is not above 0 or is above 10,000 Hz, and for more
    than two million rows.
    """
    for rate in (from_hz, to_hz):
        if not 0 < rate <= MAX_RATE_HZ:
            raise RobotError(f"the rate is {rate} Hz; give one above 0 and up to {MAX_RATE_HZ:.0f}")
    if from_hz == to_hz:
        return qpos
    spans = (len(qpos) - 1) * to_hz / from_hz  # infinite for a rate close to zero
    count = resampled_length(len(qpos), from_hz, to_hz) if math.isfinite(spans) else spans
    if count > MAX_ROWS:
        raise RobotError(f"{len(qpos)} rows at {from_hz:g} Hz are {count} at {to_hz:g} Hz; {MAX_ROWS} at most are made")
    if count == 1:
        return qpos[:1]
    at = torch.arange(count, dtype=torch.float64, device=qpos.device) * (from_hz / to_hz)
    # The tiny offset keeps a row that coincides with a source row from falling just before it.
    first = (at + 1e-6).long().clamp(max=len(qpos) - 1)
    second = (first + 1).clamp(max=len(qpos) - 1)
    fraction = (at - first).clamp(0, 1)
    linear = torch.lerp(qpos[first], qpos[second], fraction[:, None].to(qpos.dtype))
    root = slerp(qpos[first, 3:7], qpos[second, 3:7], fraction.to(qpos.dtype))
    return torch.cat([linear[:, :3], root, linear[:, 7:]], dim=1)


def velocities(qpos: Tensor, rate_hz: float) -> Tensor:
    """Qvel (T, 35) of qpos rows (T, 36) with continuous quaternions, as in `JointTrajectory`."""
    if len(qpos) < 2:
        return qpos.new_zeros(len(qpos), QVEL_WIDTH)
    step = (qpos[1:] - qpos[:-1]) * rate_hz
    turn = relative_rotation(qpos[:-1, 3:7], qpos[1:, 3:7]) * rate_hz
    qvel = torch.cat([step[:, :3], turn, step[:, 7:]], dim=1)
    return torch.cat([qvel, qvel[-1:]])


def relative_rotation(start: Tensor, end: Tensor) -> Tensor:
    """Axis times angle (..., 3), in the frame of `start`, of the rotation to `end`; both unit quaternions (..., 4)."""
    real = (start * end).sum(-1, keepdim=True)
    imaginary = start[..., :1] * end[..., 1:] - end[..., :1] * start[..., 1:]
    imaginary = imaginary - torch.linalg.cross(start[..., 1:], end[..., 1:])
    imaginary = torch.where(real < 0, -imaginary, imaginary)
    sine = imaginary.norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(sine, real.abs())
    tiny = sine < 1e-12
    return imaginary * torch.where(tiny, 2.0, angle / torch.where(tiny, 1.0, sine))


def controller_trajectory(
    qpos: Tensor, from_hz: float, rate_hz: float | None = None
) -> tuple[JointTrajectory, TrajectoryReport]:
    """Qpos rows (T, 36) at from_hz as a trajectory that a controller at rate_hz can follow; None: the same rate.

    Angles are first clamped, then resampled, then differentiated. Raises RobotError for invalid qpos or rates.
    """
    check_qpos(qpos)
    rate_hz = from_hz if rate_hz is None else rate_hz
    kept, clamped = clamp_to_range(qpos.double())
    unit = kept[:, 3:7] / kept[:, 3:7].norm(dim=1, keepdim=True)
    kept = torch.cat([kept[:, :3], continuous_signs(unit), kept[:, 7:]], dim=1)
    kept = resample_qpos(kept, from_hz, rate_hz)
    qvel = velocities(kept, rate_hz)
    time_s = torch.arange(len(kept), dtype=torch.float64, device=kept.device) / rate_hz
    report = TrajectoryReport(clamped=clamped, too_fast=too_fast(qvel))
    return JointTrajectory(time_s, kept, qvel, rate_hz), report


def motion_trajectory(motion: Motion, rate_hz: float | None = None) -> tuple[JointTrajectory, TrajectoryReport]:
    """As `controller_trajectory`, for a motion with the skeleton g134; the report includes what hinges cannot do."""
    qpos = motion_to_qpos(motion)
    trajectory, report = controller_trajectory(qpos, motion.fps, rate_hz)
    return trajectory, TrajectoryReport(report.clamped, report.too_fast, lost(motion, qpos))


def lost(motion: Motion, qpos: Tensor) -> tuple[Excess, ...]:
    """The joints of a motion whose rotations their hinges in qpos (T, 36) cannot reproduce."""
    return _excesses(lost_rotation(motion, qpos), load_g1().skeleton.joint_names, "rad", _LOST_RAD)


def too_fast(qvel: Tensor) -> tuple[Excess, ...]:
    """The hinges of qvel (T, 35) that exceed the robot's joint speeds."""
    robot = load_g1()
    return _excesses((qvel[:, 6:].abs() - robot.speed_limits).clamp(min=0), robot.hinges, "rad/s", 1e-9)


def _excesses(beyond: Tensor, names: tuple[str, ...], unit: str, least: float) -> tuple[Excess, ...]:
    """One entry for every column of (T, K) that exceeds `least` anywhere."""
    counts, worst = (beyond > least).sum(0).tolist(), beyond.amax(0).tolist()
    return tuple(Excess(names[k], counts[k], len(beyond), worst[k], unit) for k in range(len(names)) if counts[k])
