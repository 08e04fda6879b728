"""Motion of the Unitree G1 as CSV: ARDY's 36 columns of qpos, and a form that a controller can follow.

The first has no header and no clock: 25 rows a second of root x y z (metres), quaternion w x y z, 29 angles (radians),
Z up, +X forward. The second has a header line; its columns are the time, the same 36 columns, and 35 of velocity.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.formats.bounded import MAX_FRAMES, check_num_frames, read_text
from motiongen_ardy.formats.errors import FormatError, shortened
from motiongen_ardy.formats.stored import StoredMotion, as_array, from_pose, whole_fps
from motiongen_ardy.robot.g1 import QPOS_WIDTH, RobotError, check_qpos, load_g1, motion_to_qpos, qpos_to_motion
from motiongen_ardy.robot.trajectory import QVEL_WIDTH, JointTrajectory, TrajectoryReport, lost, motion_trajectory

QPOS_FPS = 25
_NUMBER = "%.9g"
_CLOCK_WITHIN = 1e-3  # of a period


def controller_columns() -> tuple[str, ...]:
    """The header of the controller form: each column's name with its unit."""
    hinges = load_g1().hinges
    root = ("root_x_m", "root_y_m", "root_z_m", "root_qw", "root_qx", "root_qy", "root_qz")
    speed = ("root_vx_m_s", "root_vy_m_s", "root_vz_m_s", "root_wx_rad_s", "root_wy_rad_s", "root_wz_rad_s")
    angles, rates = (tuple(f"{hinge}_joint_{unit}" for hinge in hinges) for unit in ("rad", "rad_s"))
    return ("time_s", *root, *angles, *speed, *rates)


def write_qpos_csv(path: Path, stored: StoredMotion) -> TrajectoryReport:
    """Write ARDY's 36 columns at the motion's own rate, angles unchanged. Returns what hinges cannot do.

    Raises FormatError for a motion with another skeleton.
    """
    qpos = _qpos(path, stored)
    _write_rows(path, qpos)
    return TrajectoryReport(lost=lost(stored.motion, qpos))


def read_qpos_csv(path: Path, fps: float = QPOS_FPS) -> StoredMotion:
    """Read ARDY's 36 columns as motion at fps, which the file does not contain. Raises FormatError."""
    return qpos_motion(path, read_qpos(path), fps)


def read_qpos(path: Path) -> Tensor:
    """Read ARDY's 36 columns unchanged: (T, 36) float64. Raises FormatError."""
    return _checked(path, _rows(path, read_text(path).splitlines(), 1, QPOS_WIDTH))


def write_controller_csv(path: Path, stored: StoredMotion, rate_hz: float | None = None) -> TrajectoryReport:
    """Write the controller form at rate_hz (None: the motion's own rate). Returns what was clamped or is wrong.

    Raises FormatError for a motion with another skeleton, and RobotError for an invalid rate.
    """
    _qpos(path, stored)
    trajectory, report = motion_trajectory(stored.motion, rate_hz)
    write_trajectory(path, trajectory)
    return report


def write_trajectory(path: Path, trajectory: JointTrajectory) -> None:
    """Write a trajectory in the controller form."""
    table = torch.cat([trajectory.time_s[:, None], trajectory.qpos, trajectory.qvel], dim=1)
    _write_rows(path, table, ",".join(controller_columns()))


def read_trajectory(path: Path) -> JointTrajectory:
    """Read the controller form. Raises FormatError for another header, and for a clock that is not uniform."""
    lines = read_text(path).splitlines()
    names = tuple(lines[0].strip().split(",")) if lines else ()
    wanted = controller_columns()
    if names != wanted:
        first = next((index for index, pair in enumerate(zip(names, wanted, strict=False)) if pair[0] != pair[1]), None)
        given = f"a header of {len(names)} columns" if first is None else f"column {first} is {shortened(names[first])}"
        raise FormatError(path, given, f"the {len(wanted)} columns are time_s, root_x_m ... in the order of the docs")
    table = _rows(path, lines[1:], 2, len(wanted))
    time_s, qpos = table[:, 0], _checked(path, table[:, 1 : 1 + QPOS_WIDTH])
    if len(table) < 2:
        raise FormatError(path, "one row", "give two or more: the rate follows from the clock")
    period = float(time_s[-1] - time_s[0]) / (len(table) - 1)
    even = time_s[0] + period * torch.arange(len(table), dtype=torch.float64, device=table.device)
    if not period > 0 or float((time_s - even).abs().max()) > _CLOCK_WITHIN * period:
        raise FormatError(path, "time_s does not grow evenly", "resample it to one rate first")
    return JointTrajectory(time_s, qpos, table[:, 1 + QPOS_WIDTH :][:, :QVEL_WIDTH], round(1 / period, 6))


def read_controller_csv(path: Path) -> StoredMotion:
    """Read the controller form as motion; its rate must be a whole number. Raises FormatError."""
    trajectory = read_trajectory(path)
    return qpos_motion(path, trajectory.qpos, trajectory.rate_hz)


def qpos_motion(source: object, qpos: Tensor, fps: float) -> StoredMotion:
    """Valid qpos (T, 36) as stored motion in float32."""
    check_num_frames(source, len(qpos))
    motion = qpos_to_motion(qpos, whole_fps(source, fps))
    rotations, root, contacts = motion.local_rotations, motion.root_positions, motion.foot_contacts
    return from_pose(load_g1().skeleton, rotations, root, motion.fps, source=source, contacts=contacts)


def _write_rows(path: Path, table: Tensor, header: str = "") -> None:
    # An open file: given a name, numpy would compress one that ends in .gz.
    with written_whole(path) as partial, partial.open("w", encoding="ascii", newline="\n") as file:
        np.savetxt(file, as_array(table), fmt=_NUMBER, delimiter=",", header=header, comments="")


def _qpos(path: Path, stored: StoredMotion) -> Tensor:
    robot = load_g1().skeleton
    if stored.skeleton.joint_names != robot.joint_names:
        raise FormatError(
            path, f"a motion of {stored.skeleton.name}", f"this format holds motion of {robot.name} alone"
        )
    return motion_to_qpos(stored.motion)


def _checked(path: Path, qpos: Tensor) -> Tensor:
    try:
        check_qpos(qpos)
    except RobotError as error:
        raise FormatError(path, str(error), "rows are root x y z, quaternion w x y z, 29 angles") from None
    return qpos


def _rows(path: Path, lines: list[str], first_line: int, width: int) -> Tensor:
    """The numbers (T, width) in comma-separated lines; blank lines at the end are ignored."""
    while lines and not lines[-1].strip():
        lines = lines[:-1]
    if not 1 <= len(lines) <= MAX_FRAMES:
        raise FormatError(path, f"{len(lines)} rows", f"give 1 to {MAX_FRAMES}")
    table = np.empty((len(lines), width))
    for row, text in enumerate(lines):
        table[row] = _numbers(path, first_line + row, text, width)
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise FormatError(path, f"line {first_line + bad[0]} holds NaN or infinite numbers", "numbers must be finite")
    return torch.from_numpy(table)


def _numbers(path: Path, line: int, text: str, width: int) -> list[float]:
    words = text.split(",")
    if len(words) != width:
        given = f"line {line} has {len(words)} columns"
        raise FormatError(path, given, f"{width} are wanted, without a header; centimetres and degrees are not read")
    values = []
    for word in words:
        try:
            values.append(float(word))
        except ValueError:
            given = f"line {line} holds {shortened(word.strip())}"
            raise FormatError(path, given, f"{width} numbers a line, no other text") from None
    return values
