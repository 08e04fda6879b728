"""Uploaded motion files: those that a page could not draw are refused, with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.formats.bvh import write_bvh as write_person
from motiongen_client import InvalidInput, Motion
from motiongen_tools.bvh import write_bvh
from motiongen_tools.conversion import ConversionFailed
from motiongen_tools.npz import write_npz
from motiongen_tools.view.motion_files import read_upload
from tests.ardy.formats.motions import random_motion


def test_a_bvh_file_of_a_skeleton_unknown_to_the_server_is_refused(tmp_path: Path, stick_motion: Motion) -> None:
    write_person(tmp_path / "walk.bvh", random_motion(load_skeleton("core27"), 2, seed=0))
    with pytest.raises(InvalidInput, match=r"motion of 27 joints.*the server's rigs: stick9 \(9 joints\)"):
        read_upload("walk.bvh", (tmp_path / "walk.bvh").read_bytes(), [stick_motion.rig])


def test_a_bvh_file_of_a_skeleton_unknown_to_the_converter_is_refused(tmp_path: Path, stick_motion: Motion) -> None:
    write_bvh(tmp_path / "walk.bvh", stick_motion)
    with pytest.raises(ConversionFailed, match=r"^walk\.bvh: "):
        read_upload("walk.bvh", (tmp_path / "walk.bvh").read_bytes(), [stick_motion.rig])


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"parents": (0,) * 9}, "form a tree"),
        ({"parents": (-1, 0)}, "2 parents"),
        ({"offsets_m": np.full((9, 3), np.nan, np.float32)}, "not finite"),
        ({"offsets_m": np.zeros((2, 3), np.float32)}, "offsets of shape"),
        ({"frame_rate_hz": 0}, "0 frames a second"),
        ({"block_names": ["a", "b", "c"]}, "root_translation_m has width None"),
        ({"rows": np.full((2, 43), np.inf, np.float32)}, "not finite"),
    ],
)
def test_an_npz_file_with_an_invalid_skeleton_or_numbers_is_refused(
    tmp_path: Path, stick_motion: Motion, change: dict[str, object], said: str
) -> None:
    path = tmp_path / "walk.npz"
    write_npz(path, stick_motion)
    with np.load(path) as held:
        arrays = dict(held)
    np.savez(path, **{**arrays, **change})  # type: ignore[arg-type]
    with pytest.raises(InvalidInput, match=said):
        read_upload("walk.npz", path.read_bytes(), [stick_motion.rig])
