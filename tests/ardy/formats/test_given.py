"""Writers accept motion in any type, layout and device, and torch's default device does not change their files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constants import constant
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.files import MOTION_FORMATS, MotionFormat, ReadOptions, read_motion, write_motion
from motiongen_ardy.formats.stored import MAX_TEXT_LENGTH, StoredMotion, whole_fps
from motiongen_ardy.robot.g1 import load_g1, qpos_to_local_rotations
from tests.ardy.formats.motions import random_motion
from tests.ardy.robot.poses import walking_qpos
from tests.pretend_device import AWAY, pretended

ROBOT = load_skeleton("g134")
WALK = random_motion(ROBOT, 5, seed=1, fps=25)


def stored(local: Tensor, root: Tensor, **more: Any) -> StoredMotion:
    return StoredMotion(ROBOT, Motion(local, root, torch.zeros(len(root), 4, dtype=torch.bool), 25), **more)


@pytest.mark.parametrize("chosen", MOTION_FORMATS, ids=lambda one: one.name)
@pytest.mark.parametrize(
    "change",
    [
        lambda values: values.clone().requires_grad_(True),
        lambda values: values.double(),
        lambda values: values.transpose(0, -1).contiguous().transpose(0, -1),
    ],
    ids=["with a graph", "float64", "strided"],
)
def test_tensors_of_any_type_and_layout_are_written_alike(tmp_path: Path, chosen: MotionFormat, change: Any) -> None:
    local, root = WALK.motion.local_rotations, WALK.motion.root_positions
    write_motion(tmp_path / f"plain{chosen.suffix}", stored(local, root))
    write_motion(tmp_path / f"other{chosen.suffix}", stored(change(local), change(root)))
    plain, other = (tmp_path / f"{name}{chosen.suffix}" for name in ("plain", "other"))
    assert plain.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("dtype", [torch.int64, torch.bfloat16])
def test_tensors_of_int64_and_bfloat16_are_written(tmp_path: Path, dtype: torch.dtype) -> None:
    turns = torch.eye(3, dtype=dtype).expand(3, ROBOT.num_joints, 3, 3)
    for chosen in MOTION_FORMATS:
        path = tmp_path / f"still{chosen.suffix}"
        write_motion(path, stored(turns, torch.ones(3, 3, dtype=dtype)))
        if chosen.read is not None:
            assert torch.equal(read_motion(path).motion.root_positions, torch.ones(3, 3))


@pytest.mark.parametrize("chosen", MOTION_FORMATS, ids=lambda one: one.name)
def test_motion_on_any_device_is_written_alike(tmp_path: Path, chosen: MotionFormat) -> None:
    here = WALK.motion
    write_motion(tmp_path / f"here{chosen.suffix}", StoredMotion(ROBOT, here))
    with pretended():
        parts = (here.local_rotations, here.root_positions, here.foot_contacts)
        there = Motion(*(part.to(AWAY) for part in parts), here.fps)
        write_motion(tmp_path / f"there{chosen.suffix}", StoredMotion(ROBOT, there))
    constant.cache_clear()  # some cached tables are on the pretended device
    written, other = (tmp_path / f"{name}{chosen.suffix}" for name in ("here", "there"))
    assert written.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("chosen", MOTION_FORMATS, ids=lambda one: one.name)
def test_files_are_the_same_whatever_the_default_device_is(tmp_path: Path, chosen: MotionFormat) -> None:
    before, after = (tmp_path / f"{name}{chosen.suffix}" for name in ("before", "after"))
    write_motion(before, WALK)
    load_g1.cache_clear()
    with torch.device("meta"):
        write_motion(after, WALK)
        again = read_motion(after) if chosen.read is not None else WALK
    assert before.read_bytes() == after.read_bytes()
    assert again.motion.root_positions.device.type == "cpu"


def test_robot_tables_loaded_in_inference_mode_can_be_used_in_autograd() -> None:
    load_g1.cache_clear()
    with torch.inference_mode():
        load_g1()
    qpos = walking_qpos(3, 25).requires_grad_(True)
    qpos_to_local_rotations(qpos).sum().backward()
    assert qpos.grad is not None


@pytest.mark.parametrize("fps", [True, 0, 1001, 20.0])
def test_frame_rates_that_are_not_integers_in_range_are_refused(fps: Any) -> None:
    motion = WALK.motion
    with pytest.raises(FormatError, match="give a whole number of 1 to 1000"):
        StoredMotion(ROBOT, Motion(motion.local_rotations, motion.root_positions, motion.foot_contacts, fps))


def test_a_long_text_is_kept_whole_or_refused(tmp_path: Path) -> None:
    local, root = WALK.motion.local_rotations, WALK.motion.root_positions
    text = "a person walks, " * 2_000
    write_motion(tmp_path / "walk.npz", stored(local, root, text=text))
    assert read_motion(tmp_path / "walk.npz").text == text
    with pytest.raises(FormatError, match="a text of 1000001 characters; give 1000000 at most"):
        stored(local, root, text="x" * (MAX_TEXT_LENGTH + 1))


def test_a_text_with_a_lone_surrogate_is_refused() -> None:
    with pytest.raises(FormatError, match=r"half of a surrogate pair, '.ud83e'; give whole characters"):
        stored(WALK.motion.local_rotations, WALK.motion.root_positions, text="waves \ud83e")


@pytest.mark.parametrize("suffix", [".csv", ".controller.csv"])
def test_reading_a_robot_file_with_another_skeleton_is_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"walk{suffix}"
    write_motion(path, WALK)
    assert read_motion(path, ReadOptions(ROBOT)).skeleton is ROBOT
    with pytest.raises(FormatError, match="the skeleton core27 for a file of the robot G1; its skeleton is g134"):
        read_motion(path, ReadOptions(load_skeleton("core27")))


@pytest.mark.parametrize(
    "frame_time_s",
    [
        1001 / 24000,
        1001 / 30000,
        1001 / 60000,
        0.0417083,
        0.041708,
        0.033366666,
        0.0333667,
        0.0166833,
        0.016683,
        0.0167,
    ],
)
def test_rates_of_film_and_television_are_refused_however_they_are_rounded(frame_time_s: float) -> None:
    with pytest.raises(FormatError, match="resample it first"):
        whole_fps("walk", 1 / frame_time_s)


@pytest.mark.parametrize(
    ("frame_time_s", "fps"),
    [(0.0333, 30), (0.033333, 30), (0.00833, 120), (0.0083333, 120), (0.0166667, 60), (0.05, 20)],
)
def test_rounded_frame_times_are_read_as_whole_rates(frame_time_s: float, fps: int) -> None:
    assert whole_fps("walk", 1 / frame_time_s) == fps
