"""NPZ in ARDY's format: the model library reads what the client writes, and the other way round."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.formats.npz import read_npz, write_npz
from motiongen_client import InvalidInput, Motion, Rig
from motiongen_client.kinematics import axis_angle_to_quaternion, matrix_to_quaternion, quaternion_to_matrix
from motiongen_tools.ardy_npz import read_ardy_npz, write_ardy_npz
from motiongen_tools.cli_generate import read_prior
from tests.tools.test_constraint_file import rig_of

SKELETONS = ("core27", "g134")


def motion(name: str, num_frames: int = 12) -> Motion:
    rig, numbers = rig_of(name), np.random.default_rng(3)
    rows = numbers.normal(size=(num_frames, rig.row_width)).astype(np.float32)
    quaternions = rows[:, rig.block_columns["joint_rotation_quat_wxyz"]].reshape(num_frames, -1, 4)
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    rows[:, rig.block_columns["foot_contact"]] = numbers.integers(0, 2, (num_frames, 4))
    return Motion(rig, 0, rows)


@pytest.mark.parametrize("name", SKELETONS)
def test_the_model_library_reads_and_writes_the_same_arrays(name: str, tmp_path: Path) -> None:
    made = motion(name)
    write_ardy_npz(tmp_path / "ours.npz", made, "a person walks")
    stored = read_npz(tmp_path / "ours.npz")
    assert (stored.skeleton.name, stored.text, stored.motion.fps) == (name, "a person walks", 20)
    write_npz(tmp_path / "theirs.npz", stored)
    with np.load(tmp_path / "ours.npz") as ours, np.load(tmp_path / "theirs.npz") as theirs:
        assert sorted(ours) == sorted(theirs)
        for array in ours:
            assert ours[array].dtype == theirs[array].dtype
            if array != "text":
                np.testing.assert_allclose(ours[array], theirs[array], atol=2e-5, err_msg=array)


@pytest.mark.parametrize("name", SKELETONS)
def test_motion_round_trips(name: str, tmp_path: Path) -> None:
    made = motion(name)
    write_ardy_npz(tmp_path / "a.npz", made)
    back = read_ardy_npz(tmp_path / "a.npz", made.rig)
    np.testing.assert_allclose(back.root_translation_m, made.root_translation_m)
    np.testing.assert_array_equal(back.foot_contact, made.foot_contact)
    np.testing.assert_allclose(
        quaternion_to_matrix(back.joint_rotation_quat_wxyz),
        quaternion_to_matrix(made.joint_rotation_quat_wxyz),
        atol=1e-5,
    )


def test_motion_of_another_rig_and_invalid_files_are_refused(tmp_path: Path) -> None:
    made = motion("core27")
    write_ardy_npz(tmp_path / "a.npz", made)
    with pytest.raises(InvalidInput, match="34 joints"):
        read_ardy_npz(tmp_path / "a.npz", rig_of("g134"))
    with pytest.raises(InvalidInput, match="20 frames a second"):
        read_ardy_npz(tmp_path / "a.npz", replace(made.rig, frame_rate_hz=25))
    np.savez(tmp_path / "b.npz", fps=20)
    with pytest.raises(InvalidInput, match="local_rot_mats"):
        read_ardy_npz(tmp_path / "b.npz", made.rig)
    np.savez(tmp_path / "c.npz", fps=20, local_rot_mats=np.ones((1, 27, 3, 3)), root_positions=np.zeros((1, 3)))
    with pytest.raises(InvalidInput, match="no rotations"):
        read_ardy_npz(tmp_path / "c.npz", made.rig)


def test_quaternions_and_matrices_represent_the_same_rotations() -> None:
    vectors = np.concatenate([np.eye(3) * np.pi, np.eye(3) * 1e-9, np.zeros((1, 3)), np.eye(3) * -2.5])
    quaternions = axis_angle_to_quaternion(vectors)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=-1), 1.0)
    back = matrix_to_quaternion(quaternion_to_matrix(quaternions))
    np.testing.assert_allclose(quaternion_to_matrix(back), quaternion_to_matrix(quaternions), atol=1e-12)
    assert (back[:, 0] >= 0).all()


@pytest.mark.parametrize(
    ("rig", "given", "allowed"),
    [
        (replace(rig_of("core27"), frame_rate_hz=25), "20 frames a second", "25, the rate of core27"),
        (rig_of("g134"), "local_rot_mats (12, 27, 3, 3)", "motion of g134, which has 34 joints"),
    ],
)
def test_a_history_of_another_rig_is_refused_with_its_option_and_file(
    rig: Rig, given: str, allowed: str, tmp_path: Path
) -> None:
    write_ardy_npz(tmp_path / "walk.npz", motion("core27"))
    with pytest.raises(InvalidInput) as refused:
        read_prior(tmp_path / "walk.npz", rig, None)
    assert refused.value.field == "--history"
    assert str(refused.value.given).startswith(f"{tmp_path / 'walk.npz'}, {given}")
    assert refused.value.allowed == allowed
