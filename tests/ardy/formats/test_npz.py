"""NPZ: round trip, arrays named as by ARDY, and invalid files, which are refused before memory is allocated."""

from __future__ import annotations

import io
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.core.skeleton import forward_kinematics, load_skeleton, skeleton_names
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.npz import read_npz, write_npz
from motiongen_ardy.formats.stored import StoredMotion
from tests.ardy.formats.motions import random_motion

CORE = load_skeleton("core27")


@pytest.fixture
def stored() -> StoredMotion:
    return random_motion(CORE, 9, seed=3)


@pytest.fixture
def arrays(tmp_path: Path, stored: StoredMotion) -> dict[str, Any]:
    write_npz(tmp_path / "good.npz", stored)
    with np.load(tmp_path / "good.npz") as file:
        return dict(file)


@pytest.mark.parametrize("name", skeleton_names())
def test_motion_of_every_skeleton_round_trips(tmp_path: Path, name: str) -> None:
    stored = random_motion(load_skeleton(name), 7, seed=1, fps=25)
    write_npz(tmp_path / "motion.npz", stored)
    again = read_npz(tmp_path / "motion.npz")
    assert again.skeleton.name == name
    assert (again.text, again.motion.fps) == ("a test", 25)
    assert torch.equal(again.motion.local_rotations, stored.motion.local_rotations)
    assert torch.equal(again.motion.root_positions, stored.motion.root_positions)
    assert torch.equal(again.motion.foot_contacts, stored.motion.foot_contacts)


def test_names_and_shapes_of_arrays_are_those_of_ardy(arrays: dict[str, Any], stored: StoredMotion) -> None:
    shapes = {name: array.shape for name, array in arrays.items()}
    assert shapes == {
        "local_rot_mats": (9, 27, 3, 3), "global_rot_mats": (9, 27, 3, 3), "posed_joints": (9, 27, 3),
        "root_positions": (9, 3), "smooth_root_pos": (9, 3), "foot_contacts": (9, 4), "global_root_heading": (9, 2),
        "fps": (), "text": (),
    }  # fmt: skip
    assert arrays["foot_contacts"].dtype == bool
    rotations, positions = forward_kinematics(CORE, stored.motion.local_rotations, stored.motion.root_positions)
    np.testing.assert_allclose(arrays["global_rot_mats"], rotations, atol=1e-5)
    np.testing.assert_allclose(arrays["posed_joints"], positions, atol=1e-5)
    np.testing.assert_array_equal(arrays["smooth_root_pos"], arrays["root_positions"])
    hips = positions[:, CORE.hip_joints[1]] - positions[:, CORE.hip_joints[0]]  # from the right hip to the left
    forward = np.stack([-hips[:, 2], hips[:, 0]], axis=1)  # x and z of what lies at a right angle to the hips
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    np.testing.assert_allclose(arrays["global_root_heading"], forward[:, ::-1], atol=1e-5)


def test_missing_arrays_are_derived_from_the_poses(
    tmp_path: Path, arrays: dict[str, Any], stored: StoredMotion
) -> None:
    least = {name: arrays[name] for name in ("local_rot_mats", "root_positions", "fps")}
    np.savez(tmp_path / "least.npz", **least)
    again = read_npz(tmp_path / "least.npz")
    assert again.text == ""
    assert torch.equal(again.motion.foot_contacts, stored.motion.foot_contacts)


def test_doubles_in_fortran_order_are_read(tmp_path: Path, arrays: dict[str, Any], stored: StoredMotion) -> None:
    arrays["local_rot_mats"] = np.asfortranarray(arrays["local_rot_mats"].astype(np.float64))
    np.savez_compressed(tmp_path / "other.npz", **arrays)
    assert torch.equal(read_npz(tmp_path / "other.npz").motion.local_rotations, stored.motion.local_rotations)


def bad(**changes: Any) -> Any:
    def apply(arrays: dict[str, Any]) -> None:
        for name, value in changes.items():
            if value is None:
                arrays.pop(name)
            else:
                arrays[name] = value(arrays[name]) if callable(value) else value

    return apply


def spoiled(array: Any) -> Any:
    array = array.copy()
    array[2, 3] = np.nan
    return array


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (bad(local_rot_mats=None), "local_rot_mats is missing"),
        (bad(fps=None), "fps is missing"),
        (bad(fps=29.97), "29.97 frames a second"),
        (bad(fps=-20), "give a whole number"),
        (bad(local_rot_mats=lambda a: a[:, :26]), "26 joints"),
        (bad(local_rot_mats=lambda a: a[..., 0]), r"\(frames, joints, 3, 3\) is wanted"),
        (bad(local_rot_mats=lambda a: a[None]), "one motion a file"),
        (bad(local_rot_mats=lambda a: 2 * a), "are no rotations"),
        (bad(local_rot_mats=lambda a: -a), "are no rotations"),
        (bad(local_rot_mats=spoiled), "NaN"),
        (bad(local_rot_mats=lambda a: np.zeros((0, 27, 3, 3))), "at most 200000 frames"),
        (bad(root_positions=lambda a: a[:4]), "different lengths"),
        (bad(root_positions=lambda a: a.astype(complex)), "its type must be one of f"),
        (bad(posed_joints=lambda a: a + 0.1), "not where the bones of core27 put it"),
        (bad(root_positions=lambda a: a.astype(np.float64) + 1e300), "root positions hold NaN or infinite"),
        (bad(posed_joints=lambda a: a.astype(np.float64) + 1e300), "not where the bones of core27 put it"),
        (bad(foot_contacts=lambda a: np.where(np.arange(4) < 3, a, np.nan)), "foot_contacts holds NaN"),
        (bad(text=np.array(["a", "b"])), r"text has shape \(2,\)"),
    ],
)
def test_invalid_arrays_are_refused(tmp_path: Path, arrays: dict[str, Any], change: Any, message: str) -> None:
    change(arrays)
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(FormatError, match=message):
        read_npz(tmp_path / "bad.npz")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("code", [0xD800, 0x110000, 0xFFFFFFFF])
def test_text_with_invalid_code_points_is_refused(
    tmp_path: Path, arrays: dict[str, Any], order: str, code: int
) -> None:
    content = np.array([ord("a"), code], f"{order}u4").tobytes()
    arrays["text"] = np.frombuffer(content, f"{order}U2").reshape(())
    np.savez(tmp_path / "odd.npz", **arrays)
    with pytest.raises(FormatError, match=f"text has text with the number {code:#x}"):
        read_npz(tmp_path / "odd.npz")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("text", ["", "a \U0001f9cd walks, \u00fc"])
def test_text_in_either_byte_order_is_read(tmp_path: Path, arrays: dict[str, Any], text: str, order: str) -> None:
    arrays["text"] = np.asarray(text, f"{order}U{max(1, len(text))}")
    np.savez(tmp_path / "other.npz", **arrays)
    assert read_npz(tmp_path / "other.npz").text == text


class Trap:
    """An object that writes a file when it is unpickled."""

    path = ""

    def __reduce__(self) -> Any:
        return (Path.write_text, (Path(self.path), "executed"))


def test_pickles_are_refused_and_not_executed(tmp_path: Path, arrays: dict[str, Any]) -> None:
    Trap.path = str(tmp_path / "trap")
    arrays["local_rot_mats"] = np.array([Trap()], dtype=object)
    np.savez(tmp_path / "pickled.npz", **arrays)
    with pytest.raises(FormatError, match="a pickle"):
        read_npz(tmp_path / "pickled.npz")
    (tmp_path / "plain.npz").write_bytes(pickle.dumps(Trap()))
    with pytest.raises(FormatError, match="not a readable NPZ"):
        read_npz(tmp_path / "plain.npz")
    assert not (tmp_path / "trap").exists()


def test_a_zip_bomb_is_refused_before_it_is_decompressed(tmp_path: Path) -> None:
    """The directory of the archive states the decompressed sizes; they are checked first."""
    path = tmp_path / "bomb.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("local_rot_mats.npy", b"\0" * 1000)
    content = bytearray(path.read_bytes())
    size_at = content.index(b"PK\x01\x02") + 24
    content[size_at : size_at + 4] = (2**32 - 2).to_bytes(4, "little")
    path.write_bytes(content)
    with pytest.raises(FormatError, match=r"4294967294 bytes of arrays; at most 536870912 are read"):
        read_npz(path)


def test_an_array_header_with_a_false_size_is_refused(tmp_path: Path, arrays: dict[str, Any]) -> None:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": "<f4", "fortran_order": False, "shape": (9999, 27, 3, 3)})
    np.savez(tmp_path / "lies.npz", root_positions=arrays["root_positions"], fps=arrays["fps"])
    with zipfile.ZipFile(tmp_path / "lies.npz", "a") as archive:
        archive.writestr("local_rot_mats.npy", content.getvalue() + b"\0" * 100)
    with pytest.raises(FormatError, match="has 100 bytes"):
        read_npz(tmp_path / "lies.npz")


@pytest.mark.parametrize("name", ["../fps.npy", "a/b.npy", "..\\fps.npy", "readme.txt"])
def test_members_without_plain_array_names_are_refused(tmp_path: Path, name: str) -> None:
    with zipfile.ZipFile(tmp_path / "odd.npz", "w") as archive:
        archive.writestr(name, b"x")
    with pytest.raises(FormatError, match="plain names, each once"):
        read_npz(tmp_path / "odd.npz")


def test_a_duplicate_member_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "twice.npz", "w") as archive:
        archive.writestr("fps.npy", b"x")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("fps.npy", b"y")
    with pytest.raises(FormatError, match="plain names, each once"):
        read_npz(tmp_path / "twice.npz")


@pytest.mark.parametrize("keep", [0, 1, 100, 1000, -1])
def test_truncated_files_are_refused(tmp_path: Path, stored: StoredMotion, keep: int) -> None:
    write_npz(tmp_path / "cut.npz", stored)
    content = (tmp_path / "cut.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(content[:keep])
    with pytest.raises(FormatError, match="NPZ"):
        read_npz(tmp_path / "cut.npz")
