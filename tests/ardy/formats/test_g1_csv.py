"""The robot's two CSV formats: ARDY's 36 columns, and the one that a controller can follow."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.core.representation import motion_from_pose
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.g1_csv import (
    controller_columns,
    qpos_motion,
    read_controller_csv,
    read_qpos,
    read_qpos_csv,
    read_trajectory,
    write_controller_csv,
    write_qpos_csv,
)
from motiongen_ardy.formats.stored import StoredMotion
from motiongen_ardy.robot.g1 import load_g1
from tests.ardy.formats.motions import random_motion
from tests.ardy.robot.poses import random_qpos, walking_qpos

ROBOT = load_g1()
KNEE = 7 + ROBOT.hinges.index("left_knee")


@pytest.fixture
def walk() -> StoredMotion:
    return qpos_motion("walk", walking_qpos(26, 25), 25)


def test_qpos_round_trips(tmp_path: Path, walk: StoredMotion) -> None:
    report = write_qpos_csv(tmp_path / "walk.csv", walk)
    assert report.lines == ()
    np.testing.assert_allclose(read_qpos(tmp_path / "walk.csv"), walking_qpos(26, 25), atol=1e-6)
    again = read_qpos_csv(tmp_path / "walk.csv")
    assert (again.skeleton.name, again.motion.fps) == ("g134", 25)
    torch.testing.assert_close(again.positions(), walk.positions(), atol=1e-5, rtol=0)
    assert torch.equal(again.motion.foot_contacts, walk.motion.foot_contacts)


def test_the_columns_are_those_of_ardy(tmp_path: Path) -> None:
    """Read by numpy.loadtxt, as ARDY's users do: no header, 36 columns, the root first and then the hinges."""
    qpos = random_qpos(4, 7)
    write_qpos_csv(tmp_path / "motion.csv", qpos_motion("random", qpos, 25))
    table = np.loadtxt(tmp_path / "motion.csv", delimiter=",")
    assert table.shape == (4, 36)
    np.testing.assert_allclose(table[:, :3], qpos[:, :3], atol=1e-6)
    np.testing.assert_allclose(table[:, 7:], qpos[:, 7:], atol=1e-5)


def test_the_columns_of_the_controller_format_hold_what_their_names_say(tmp_path: Path) -> None:
    """A robot that walks along +X at 1 m/s, half a metre up, turns left by 90 degrees a second, and bends a knee."""
    qpos, time_s = walking_qpos(26, 25), torch.arange(26, dtype=torch.float64) / 25
    qpos[:, 0], qpos[:, 1], qpos[:, 2] = time_s, 0.25, 0.5
    qpos[:, 3], qpos[:, 4:6], qpos[:, 6] = torch.cos(math.pi / 4 * time_s), 0, torch.sin(math.pi / 4 * time_s)
    qpos[:, KNEE] = time_s
    write_controller_csv(tmp_path / "walk.controller.csv", qpos_motion("walk", qpos, 25))
    with (tmp_path / "walk.controller.csv").open() as file:
        row = {name: float(word) for name, word in list(csv.DictReader(file))[-1].items()}
    half = math.sin(math.pi / 4)
    for name, value in {
        "time_s": 1, "root_x_m": 1, "root_y_m": 0.25, "root_z_m": 0.5,
        "root_qw": half, "root_qx": 0, "root_qy": 0, "root_qz": half, "left_knee_joint_rad": 1,
        "root_vx_m_s": 1, "root_vy_m_s": 0, "root_vz_m_s": 0,
        "root_wx_rad_s": 0, "root_wy_rad_s": 0, "root_wz_rad_s": math.pi / 2, "left_knee_joint_rad_s": 1,
    }.items():  # fmt: skip
        assert row[name] == pytest.approx(value, abs=1e-4), name


def test_the_clock_may_be_rounded_by_less_than_a_thousandth_of_a_period(tmp_path: Path, walk: StoredMotion) -> None:
    path = tmp_path / "walk.controller.csv"
    write_controller_csv(path, walk, 30)
    header, *rows = path.read_text().splitlines()

    def rounded(digits: int) -> str:
        parts = [row.split(",", 1) for row in rows]
        return "\n".join([header, *(f"{float(time_s):.{digits}f},{more}" for time_s, more in parts)])

    path.write_text(rounded(5))
    assert read_trajectory(path).rate_hz == pytest.approx(30)
    path.write_text(rounded(3))
    with pytest.raises(FormatError, match="time_s does not grow evenly"):
        read_trajectory(path)


def test_contacts_are_those_of_the_poses(walk: StoredMotion) -> None:
    contacts = walk.motion.foot_contacts
    wanted = motion_from_pose(
        walk.skeleton, walk.motion.local_rotations.double(), walk.motion.root_positions.double(), 25
    ).foot_contacts
    assert torch.equal(contacts, wanted)
    assert contacts.any()


def test_a_table_saved_by_a_spreadsheet_with_a_byte_order_mark_is_read(tmp_path: Path, walk: StoredMotion) -> None:
    for write, read in ((write_qpos_csv, read_qpos_csv), (write_controller_csv, read_controller_csv)):
        write(tmp_path / "walk.csv", walk)
        (tmp_path / "marked.csv").write_bytes(b"\xef\xbb\xbf" + (tmp_path / "walk.csv").read_bytes())
        assert torch.equal(read(tmp_path / "marked.csv").positions(), read(tmp_path / "walk.csv").positions())


def test_rotation_that_the_hinges_cannot_do_is_reported(tmp_path: Path) -> None:
    report = write_qpos_csv(tmp_path / "odd.csv", random_motion(ROBOT.skeleton, 4, seed=1))
    (line,) = report.lines
    assert line.startswith("rotation lost that the hinges cannot do: ")
    assert line.endswith("more")


@pytest.mark.parametrize("rate_hz", [None, 50, 100, 500])
def test_the_controller_format_has_times_and_joint_velocities_at_any_rate(
    tmp_path: Path, walk: StoredMotion, rate_hz: float | None
) -> None:
    report = write_controller_csv(tmp_path / "walk.controller.csv", walk, rate_hz)
    assert report.lines == ()
    header, *rows = (tmp_path / "walk.controller.csv").read_text().splitlines()
    assert tuple(header.split(",")) == controller_columns()
    assert len(controller_columns()) == 1 + 36 + 35
    rate = rate_hz or 25
    assert len(rows) == rate + 1
    trajectory = read_trajectory(tmp_path / "walk.controller.csv")
    assert trajectory.rate_hz == rate
    torch.testing.assert_close(trajectory.time_s, torch.arange(rate + 1, dtype=torch.float64) / rate, atol=1e-6, rtol=0)
    moved = (trajectory.qpos[1:, 7:] - trajectory.qpos[:-1, 7:]) * rate
    torch.testing.assert_close(trajectory.qvel[:-1, 6:], moved, atol=2e-5, rtol=0)
    again = read_controller_csv(tmp_path / "walk.controller.csv")
    assert again.motion.fps == rate
    torch.testing.assert_close(again.positions()[0], walk.positions()[0], atol=1e-5, rtol=0)
    torch.testing.assert_close(again.positions()[-1], walk.positions()[-1], atol=1e-5, rtol=0)


@pytest.mark.parametrize("rate_hz", [None, 50, 100, 500])
def test_angles_out_of_range_are_clamped_only_in_the_controller_format(tmp_path: Path, rate_hz: float | None) -> None:
    qpos = walking_qpos(6, 25)
    qpos[3, KNEE] = -0.5
    stored = qpos_motion("bent", qpos, 25)
    assert write_qpos_csv(tmp_path / "raw.csv", stored).clamped == ()
    assert read_qpos(tmp_path / "raw.csv")[3, KNEE] == pytest.approx(-0.5, abs=1e-6)
    report = write_controller_csv(tmp_path / "kept.csv", stored, rate_hz)
    assert [(one.joint, one.frames) for one in report.clamped] == [("left_knee", 1)]
    kept = read_trajectory(tmp_path / "kept.csv").qpos
    assert kept[3 * int(rate_hz or 25) // 25, KNEE] == pytest.approx(-0.087267)
    assert (kept[:, 7:] >= ROBOT.lower - 1e-8).all()
    assert (kept[:, 7:] <= ROBOT.upper + 1e-8).all()


def test_the_sign_of_the_quaternion_is_continuous_over_whole_turns(tmp_path: Path) -> None:
    """A robot that turns passes angles at which w of the shortest rotation's quaternion changes its sign."""
    qpos = walking_qpos(100, 25)
    angle = torch.linspace(0, 4 * math.pi, 100, dtype=torch.float64)
    qpos[:, 3], qpos[:, 6] = torch.cos(angle / 2), torch.sin(angle / 2)
    write_controller_csv(tmp_path / "round.csv", qpos_motion("round", qpos, 25))
    quaternions = read_trajectory(tmp_path / "round.csv").qpos[:, 3:7]
    assert ((quaternions[1:] * quaternions[:-1]).sum(1) > 0.9).all()


def test_motion_of_another_skeleton_is_refused_before_a_file_is_created(tmp_path: Path) -> None:
    stored = random_motion(load_skeleton("core27"), 4, seed=1)
    for write in (write_qpos_csv, write_controller_csv):
        with pytest.raises(FormatError, match="a motion of core27; this format holds motion of g134 alone"):
            write(tmp_path / "people.csv", stored)
    assert not (tmp_path / "people.csv").exists()


def edited(line: int, column: int, word: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        rows = [row.split(",") for row in text.splitlines()]
        rows[line][column] = word
        return "\n".join(",".join(row) for row in rows)

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "0 rows; give 1 to"),
        (lambda text: "Frame,root_x,root_y\n" + text, "line 1 has 3 columns; 36 are wanted, without a header"),
        (lambda text: text.replace(",", ";"), "line 1 has 1 columns"),
        (edited(2, 9, "nan"), "line 3 holds NaN"),
        (edited(2, 9, "1e999"), "line 3 holds NaN"),
        (edited(2, 9, "0x10"), "line 3 holds '0x10'; 36 numbers a line"),
        (edited(2, 9, ""), "line 3 holds ''"),
        (edited(1, 3, "5"), r"quaternion in row 1 .* has length"),
        (lambda text: text.replace("\n", "\n\n", 1), "line 2 has 1 columns"),
    ],
)
def test_invalid_qpos_files_are_refused(
    tmp_path: Path, walk: StoredMotion, change: Callable[[str], str], message: str
) -> None:
    path = tmp_path / "bad.csv"
    write_qpos_csv(path, walk)
    path.write_text(change(path.read_text()))
    with pytest.raises(FormatError, match=message):
        read_qpos_csv(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: "", "a header of 0 columns"),
        (edited(0, 9, "left_hip_wiggle_joint_rad"), "column 9 is 'left_hip_wiggle_joint_rad'"),
        (lambda text: text.split("\n", 1)[0], "0 rows"),
        (lambda text: "\n".join(text.split("\n")[:2]), "one row; give two or more"),
        (edited(3, 0, "7"), "time_s does not grow evenly"),
        (lambda text: "\n".join([text.split("\n")[0]] + [text.split("\n")[1]] * 3), "does not grow evenly"),
        (edited(3, 40, "fast"), "line 4 holds 'fast'"),
    ],
)
def test_invalid_controller_files_are_refused(
    tmp_path: Path, walk: StoredMotion, change: Callable[[str], str], message: str
) -> None:
    path = tmp_path / "bad.controller.csv"
    write_controller_csv(path, walk)
    path.write_text(change(path.read_text()))
    with pytest.raises(FormatError, match=message):
        read_trajectory(path)


def test_a_fractional_rate_is_read_as_a_trajectory_and_not_as_motion(tmp_path: Path, walk: StoredMotion) -> None:
    write_controller_csv(tmp_path / "slow.controller.csv", walk, 12.5)
    assert read_trajectory(tmp_path / "slow.controller.csv").rate_hz == 12.5
    with pytest.raises(FormatError, match="give a whole number of frames a second"):
        read_controller_csv(tmp_path / "slow.controller.csv")
