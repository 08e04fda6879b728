"""BVH of every skeleton: written, parsed by the reader of motion capture, and read back as the same motion."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core.skeleton import load_skeleton, skeleton_names
from motiongen_ardy.data.bvh import axis_rotation
from motiongen_ardy.data.bvh import read_bvh as parse_file
from motiongen_ardy.formats.bvh import euler_zxy, read_bvh, write_bvh
from motiongen_ardy.formats.errors import FormatError
from tests.ardy.formats.motions import random_motion

CORE = load_skeleton("core27")


@pytest.mark.parametrize("units_per_metre", [100.0, 1.0, 1000.0, 1 / 0.0254])
@pytest.mark.parametrize("name", skeleton_names())
def test_motion_of_every_skeleton_round_trips(tmp_path: Path, name: str, units_per_metre: float) -> None:
    stored = random_motion(load_skeleton(name), 7, seed=1, fps=25)
    write_bvh(tmp_path / "motion.bvh", stored, units_per_metre)
    again = read_bvh(tmp_path / "motion.bvh")
    assert (again.skeleton.name, again.motion.fps) == (name, 25)
    torch.testing.assert_close(again.motion.local_rotations, stored.motion.local_rotations, atol=1e-5, rtol=0)
    torch.testing.assert_close(again.positions(), stored.positions(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("fps", [24, 30, 60, 120, 240])
def test_a_frame_time_is_written_as_exactly_as_its_rate_needs(tmp_path: Path, fps: int) -> None:
    write_bvh(tmp_path / "motion.bvh", random_motion(CORE, 2, seed=1, fps=fps))
    assert read_bvh(tmp_path / "motion.bvh").motion.fps == fps
    found = re.search(r"Frame Time: (\S+)", (tmp_path / "motion.bvh").read_text())
    assert found is not None
    assert float(found[1]) * fps == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("units_per_metre", [100.0, 1.0])
def test_a_last_joint_ends_5_cm_further_on(tmp_path: Path, units_per_metre: float) -> None:
    write_bvh(tmp_path / "motion.bvh", random_motion(CORE, 2, seed=1), units_per_metre)
    text = (tmp_path / "motion.bvh").read_text()
    ends = np.array([line.split() for line in re.findall(r"End Site\s*{\s*OFFSET (.*)", text)], float)
    assert len(ends) == len(set(range(CORE.num_joints)) - set(CORE.parents))
    np.testing.assert_allclose(np.linalg.norm(ends, axis=1), 0.05 * units_per_metre, atol=1e-5)


def test_joints_may_be_in_any_order(tmp_path: Path) -> None:
    """Neither the motion's joints nor the file's are in the order of the skeleton that is read."""
    depths = [0]
    for parent in CORE.parents[1:]:
        depths.append(depths[parent] + 1)
    order = sorted(range(CORE.num_joints), key=lambda joint: (depths[joint], -joint))  # level by level, the last first
    place = {joint: at for at, joint in enumerate(order)}
    shuffled = replace(
        CORE,
        joint_names=tuple(CORE.joint_names[joint] for joint in order),
        parents=tuple(place.get(CORE.parents[joint], -1) for joint in order),
        neutral_joints=CORE.neutral_joints[order],
    )
    stored = random_motion(shuffled, 3, seed=1)
    write_bvh(tmp_path / "motion.bvh", stored)
    again = read_bvh(tmp_path / "motion.bvh")
    assert again.skeleton is CORE
    torch.testing.assert_close(again.positions()[:, order], stored.positions(), atol=1e-5, rtol=0)


def test_joint_names_may_be_any_unicode(tmp_path: Path) -> None:
    names = tuple(f"{name}_\u9aa8" for name in CORE.joint_names)
    stored = random_motion(replace(CORE, joint_names=names), 3, seed=1)
    write_bvh(tmp_path / "motion.bvh", stored)
    again = read_bvh(tmp_path / "motion.bvh", stored.skeleton)
    torch.testing.assert_close(again.positions(), stored.positions(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("name", skeleton_names())
def test_channels_of_the_file_reproduce_the_joint_positions(tmp_path: Path, name: str) -> None:
    """Read by code that the writer does not use: the file's own hierarchy, channels and kinematics."""
    skeleton = load_skeleton(name)
    stored = random_motion(skeleton, 5, seed=4)
    write_bvh(tmp_path / "motion.bvh", stored)
    file = parse_file(tmp_path / "motion.bvh")
    _, positions = file.global_pose()
    order = [file.joint_names.index(joint) for joint in skeleton.joint_names]
    torch.testing.assert_close(positions[:, order] / 100, stored.positions().double(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("away_rad", [0.0, 1e-7, 1e-5, 1e-4, 3e-4, 1e-3])
def test_rotations_near_gimbal_lock_keep_their_precision(tmp_path: Path, away_rad: float) -> None:
    stored = random_motion(CORE, 6, seed=2)
    z, y = torch.linspace(-3, 3, 6, dtype=torch.float64), torch.linspace(2, -2, 6, dtype=torch.float64)
    middle = axis_rotation(0, torch.full_like(z, np.pi / 2 - away_rad))
    stored.motion.local_rotations[:, 3] = (axis_rotation(2, z) @ middle @ axis_rotation(1, y)).float()
    write_bvh(tmp_path / "motion.bvh", stored)
    again = read_bvh(tmp_path / "motion.bvh")
    torch.testing.assert_close(again.motion.local_rotations, stored.motion.local_rotations, atol=2e-6, rtol=0)


def test_television_frame_rates_are_refused_however_they_are_rounded(tmp_path: Path) -> None:
    path = tmp_path / "motion.bvh"
    write_bvh(path, random_motion(CORE, 2, seed=1))
    text = path.read_text()
    for time_s in ("0.0333667", "0.033366666", "0.0417083", "0.041708", "0.016683"):
        path.write_text(re.sub(r"Frame Time: .*", f"Frame Time: {time_s}", text))
        with pytest.raises(FormatError, match=f"a frame time of {time_s[:8]}"):
            read_bvh(path)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(*[st.sampled_from([0.0, np.pi / 2, -np.pi / 2, np.pi]) | st.floats(-4, 4)] * 3),
        min_size=1,
        max_size=5,
    )
)
def test_euler_angles_reproduce_the_rotation(angles: list[tuple[float, float, float]]) -> None:
    """Even where the middle angle is a right angle and the other two cannot be told apart."""

    def matrix(z: float, x: float, y: float) -> np.ndarray:
        (sz, sx, sy), (cz, cx, cy) = np.sin([z, x, y]), np.cos([z, x, y])
        about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        return about_z @ about_x @ about_y

    rotations = np.stack([matrix(*row) for row in angles])
    again = np.stack([matrix(*row) for row in euler_zxy(rotations)])
    np.testing.assert_allclose(again, rotations, atol=2e-5)


def test_euler_angles_of_continuous_turning_do_not_jump(tmp_path: Path) -> None:
    stored = random_motion(CORE, 200, seed=0, size=0.2)  # turns at 2 rad/s for ten seconds
    write_bvh(tmp_path / "spin.bvh", stored)
    steps = np.abs(np.diff(parse_file(tmp_path / "spin.bvh").values, axis=0))
    assert steps.max() < 45, "degrees, or centimetres, from frame to frame"


@pytest.fixture
def text(tmp_path: Path) -> str:
    write_bvh(tmp_path / "good.bvh", random_motion(CORE, 3, seed=2))
    return (tmp_path / "good.bvh").read_text()


def without_last_line(text: str) -> str:
    return "\n".join(text.splitlines()[:-1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text.replace("Spine3", "Nose"), r"1 missing \(Spine3 \.\.\.\), 1 too many \(Nose"),
        (lambda text: re.sub(r"\bHead\b", "Swap", text).replace("Neck", "Head").replace("Swap", "Neck"), "hangs on"),
        (lambda text: re.sub(r"Frame Time: .*", "Frame Time: 0.0333667", text), "a frame time of 0.0333667 s"),
        (lambda text: re.sub(r"OFFSET .*", "OFFSET 1 1 1", text), "retarget"),
        (lambda text: re.sub(r"OFFSET .*", "OFFSET 0 0 0", text), "no unit known here fits"),
        (lambda text: re.sub(r"OFFSET .*", "OFFSET 1e308 0 0", text), "bones of inf units in all"),
        (lambda text: re.sub(r"Frames: 3", "Frames: 999999999", text), "expected 999999999 frames, found 3"),
        (lambda text: re.sub(r"Frames: 3", "Frames: ²", text), "a count of at least 1"),
        (without_last_line, "expected 3 frames, found 2"),
        (lambda text: text[: len(text) // 3], "give a BVH file"),
        (lambda text: "", "ends too early"),
        (lambda text: "HIERARCHY\n" + "JOINT a\n{\n" * 10, "expected ROOT"),
        (lambda text: "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 0\n" + "}\n" * 9, "expected MOTION"),
    ],
)
def test_invalid_files_and_foreign_skeletons_are_refused(
    tmp_path: Path, text: str, change: Callable[[str], str], message: str
) -> None:
    path = tmp_path / "bad.bvh"
    path.write_text(change(text), encoding="utf-8")
    with pytest.raises(FormatError, match=message):
        read_bvh(path)


def test_a_bone_may_be_a_centimetre_off_and_no_more_and_the_root_anywhere(tmp_path: Path) -> None:
    stored = random_motion(CORE, 3, seed=1)
    write_bvh(tmp_path / "motion.bvh", stored)
    written = (tmp_path / "motion.bvh").read_text()

    def moved(joint: str, by_cm: float) -> Path:
        line = re.compile(rf"({joint}\n\s*{{\n\s*OFFSET )(\S+)")
        text, count = line.subn(lambda found: f"{found[1]}{float(found[2]) + by_cm:.6f}", written)
        assert count == 1
        (tmp_path / "moved.bvh").write_text(text)
        return tmp_path / "moved.bvh"

    for path in (moved("JOINT LeftForeArm", 0.9), moved("ROOT Hips", 50.0)):
        torch.testing.assert_close(read_bvh(path).positions(), stored.positions(), atol=1e-5, rtol=0)
    with pytest.raises(FormatError, match=r"the bone of LeftForeArm differs by 1\.1 cm"):
        read_bvh(moved("JOINT LeftForeArm", 1.1))


def test_a_skeleton_with_too_many_joints_is_refused(tmp_path: Path) -> None:
    opened = "HIERARCHY\nROOT j\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
    opened += "".join(f"JOINT j{index}\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n" for index in range(3000))
    (tmp_path / "deep.bvh").write_text(opened)
    with pytest.raises(FormatError, match="more than 2000 joints"):
        read_bvh(tmp_path / "deep.bvh")


def test_bones_that_stretch_are_refused(tmp_path: Path, text: str) -> None:
    """Position channels below the root are read, and must agree with the OFFSET."""
    lines = text.splitlines()
    spine = next(index for index, line in enumerate(lines) if "JOINT Spine" in line and "Spine1" not in line)
    lines[spine + 3] = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"
    first = len(lines) - 3
    offset = lines[spine + 2].split()[1:]
    at = 6 + 3 * sum("JOINT" in line for line in lines[:spine])

    def placed(shift: float) -> str:
        rows = [line.split() for line in lines[first:]]
        place = [offset[0], str(float(offset[1]) + shift), offset[2]]
        return "\n".join([*lines[:first], *(" ".join([*row[:at], *place, *row[at:]]) for row in rows)]) + "\n"

    (tmp_path / "still.bvh").write_text(placed(0.0))
    assert read_bvh(tmp_path / "still.bvh").motion.num_frames == 3
    (tmp_path / "stretched.bvh").write_text(placed(5.0))
    with pytest.raises(FormatError, match=r"bone of Spine is 5\.0 cm longer"):
        read_bvh(tmp_path / "stretched.bvh")
