"""The Python client's NPZ files are read, so that their motion can be converted to every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.client_npz import read_client_npz
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.files import read_motion, write_motion
from motiongen_tools.npz import write_npz
from tests.ardy.formats.client_motion import client_motion
from tests.ardy.formats.motions import random_motion


@pytest.mark.parametrize("name", ["core27", "g134"])
def test_motion_of_the_client_is_read_and_converted(tmp_path: Path, name: str) -> None:
    stored = random_motion(load_skeleton(name), 6, seed=1)
    write_npz(tmp_path / "client.npz", client_motion(stored))
    again = read_motion(tmp_path / "client.npz")
    assert (again.skeleton.name, again.motion.fps) == (name, 20)
    torch.testing.assert_close(again.positions(), stored.positions(), atol=1e-5, rtol=0)
    assert torch.equal(again.motion.foot_contacts, stored.motion.foot_contacts)
    write_motion(tmp_path / "again.bvh", again)
    torch.testing.assert_close(read_motion(tmp_path / "again.bvh").positions(), stored.positions(), atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda arrays: arrays.pop("frame_rate_hz"), "frame_rate_hz missing; the client writes root_translation_m"),
        (lambda arrays: arrays.update(frame_rate_hz=np.asarray(20.0)), "its type must be one of i, u"),
        (lambda arrays: arrays.update(joint_names=np.array(["Hips"] * 27)), "not those of"),
        (lambda arrays: arrays.update(joint_names=np.array("Hips")), "1 axes of at most 256"),
        (lambda arrays: arrays.update(joint_names=np.append(arrays["joint_names"], "Hips")), "'Hips' twice"),
        (lambda arrays: arrays.update(root_translation_m=np.zeros((2, 3), np.float32)), "goes with the other arrays"),
        (lambda arrays: arrays.update(foot_contact=np.zeros((6, 3), np.float32)), "goes with the other arrays"),
        (lambda arrays: arrays.update(joint_rotation_quat_wxyz=np.zeros((6, 27, 4), np.float32)), "length 1"),
        (lambda arrays: arrays.update(joint_rotation_quat_wxyz=np.full((6, 27, 4), np.nan, np.float32)), "length 1"),
        (lambda arrays: arrays.update(foot_contact=np.full((6, 4), np.nan, np.float32)), "foot_contact holds NaN"),
    ],
)
def test_arrays_that_the_client_would_not_write_are_refused(
    tmp_path: Path, change: Callable[[dict[str, Any]], object], message: str
) -> None:
    path = tmp_path / "client.npz"
    write_npz(path, client_motion(random_motion(load_skeleton("core27"), 6, seed=1)))
    with np.load(path) as file:
        arrays = dict(file)
    change(arrays)
    np.savez(path, **arrays)
    with pytest.raises(FormatError, match=message):
        read_client_npz(path)
