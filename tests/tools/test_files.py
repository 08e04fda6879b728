"""Written files can be read back: BVH by another reader, NPZ by ours, PNG by matplotlib."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.data.bvh import read_bvh
from motiongen_client import InvalidInput, Motion, Rig, Waypoint
from motiongen_client.kinematics import quaternion_to_matrix
from motiongen_tools.bvh import euler_zxy, write_bvh
from motiongen_tools.npz import read_npz, write_npz
from motiongen_tools.picture import Panel, write_picture


def rotation(axis: int, angle: float) -> np.ndarray:
    """(3, 3) about x, y or z."""
    quaternion = np.zeros(4)
    quaternion[0], quaternion[1 + axis] = np.cos(angle / 2), np.sin(angle / 2)
    return quaternion_to_matrix(quaternion)


def rebuilt(angles: np.ndarray) -> np.ndarray:
    """z, x, y in radians -> Rz Rx Ry."""
    return rotation(2, angles[0]) @ rotation(0, angles[1]) @ rotation(1, angles[2])


@given(angles=st.tuples(*[st.floats(-3.14, 3.14)] * 3))
def test_euler_angles_reproduce_the_rotation(angles: tuple[float, float, float]) -> None:
    matrix = rebuilt(np.array(angles))
    again = rebuilt(euler_zxy(matrix[None, None])[0, 0])
    np.testing.assert_allclose(again, matrix, atol=1e-6)


@pytest.mark.parametrize("x", [np.pi / 2, -np.pi / 2])
def test_euler_angles_reproduce_the_rotation_in_gimbal_lock(x: float) -> None:
    matrix = rebuilt(np.array([0.4, x, 0.9]))
    np.testing.assert_allclose(rebuilt(euler_zxy(matrix[None, None])[0, 0]), matrix, atol=1e-6)


def test_euler_angles_of_continuous_turning_do_not_jump() -> None:
    headings = np.linspace(0, 6 * np.pi, 200)
    turning = np.stack([rotation(1, heading) for heading in headings])[:, None]
    np.testing.assert_allclose(euler_zxy(turning)[:, 0, 2], headings, atol=1e-6)


def test_a_bvh_file_holds_the_motion(stick_rig: Rig, tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    rows = random.normal(size=(12, stick_rig.row_width)).astype(np.float32)
    motion = Motion(stick_rig, 40, rows)
    write_bvh(tmp_path / "motion.bvh", motion)
    clip = read_bvh(tmp_path / "motion.bvh")
    order = [clip.joint_names.index(name) for name in stick_rig.joint_names]
    assert clip.num_frames == 12
    assert clip.frame_time_s == pytest.approx(0.05)
    np.testing.assert_allclose(clip.offsets[order] / 100, stick_rig.offsets_m, atol=1e-5)
    expected = quaternion_to_matrix(motion.joint_rotation_quat_wxyz)
    rotations, translations = clip.pose()
    np.testing.assert_allclose(rotations.numpy()[:, order], expected, atol=1e-5)
    np.testing.assert_allclose(translations[:, 0] / 100, motion.root_translation_m, atol=1e-5)


def test_motion_that_a_bvh_file_cannot_hold_is_refused(stick_motion: Motion, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="no frames"):
        write_bvh(tmp_path / "no.bvh", Motion(stick_motion.rig, 0, stick_motion.rows[:0]))
    spoiled = stick_motion.rows.copy()
    spoiled[3, 5] = np.nan
    with pytest.raises(InvalidInput, match="not finite"):
        write_bvh(tmp_path / "no.bvh", Motion(stick_motion.rig, 0, spoiled))
    assert not (tmp_path / "no.bvh").exists()


def test_motion_in_an_npz_file_round_trips(stick_motion: Motion, tmp_path: Path) -> None:
    write_npz(tmp_path / "motion.npz", stick_motion)
    again = read_npz(tmp_path / "motion.npz")
    np.testing.assert_array_equal(again.rows, stick_motion.rows)
    np.testing.assert_array_equal(again.joint_positions_m(), stick_motion.joint_positions_m())
    assert (again.rig.joint_names, again.rig.parents) == (stick_motion.rig.joint_names, stick_motion.rig.parents)
    assert again.rig.blocks == stick_motion.rig.blocks
    with np.load(tmp_path / "motion.npz") as arrays:
        assert arrays["joint_positions_m"].shape == (40, 9, 3)


def test_an_npz_file_of_another_format_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", rows=np.zeros(3))
    with pytest.raises(InvalidInput, match="motiongen-motion-1"):
        read_npz(tmp_path / "other.npz")


def test_a_picture_is_drawn_with_ink_in_every_row(stick_motion: Motion, tmp_path: Path) -> None:
    from matplotlib.image import imread

    panels = [Panel("one", stick_motion, [Waypoint(20, 0, 1)], [(20, "then")]), Panel("two", stick_motion)]
    write_picture(tmp_path / "sheet.png", panels, num_poses=5)
    ink = imread(tmp_path / "sheet.png")[..., :3].min(axis=-1) < 0.7
    top, bottom = np.array_split(ink, 2)
    assert top.sum() > 1000
    assert bottom.sum() > 1000


def test_a_picture_without_panels_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="0 panels"):
        write_picture(tmp_path / "no.png", [])


@pytest.mark.parametrize("data", [b"", b"not numpy's", b"PK\x03\x04 cut off", None])
def test_a_file_that_is_not_npz_is_refused(data: bytes | None, tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    if data is None:
        with path.open("wb") as file:
            np.save(file, np.zeros(3))  # one array, under the name of several
    else:
        path.write_bytes(data)
    with pytest.raises(InvalidInput, match="as write_npz makes it"):
        read_npz(path)


def test_texts_with_dollar_signs_can_be_drawn(stick_motion: Motion, tmp_path: Path) -> None:
    panel = Panel(r"for $5 $\frac{x$", stick_motion, notes=[(20, r"$_{$ and \$")])
    write_picture(tmp_path / "sheet.png", [panel], num_poses=2)
    assert (tmp_path / "sheet.png").stat().st_size > 1000


def test_an_npz_file_that_would_decompress_to_too_much_is_refused(
    stick_motion: Motion, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_npz(tmp_path / "walk.npz", stick_motion)
    packed = (tmp_path / "walk.npz").stat().st_size
    monkeypatch.setattr("motiongen_tools.npz.MAX_BYTES", packed)
    with pytest.raises(InvalidInput, match="arrays of at most 0 MiB together"):
        read_npz(tmp_path / "walk.npz")
