"""Uploaded motion files: those that a page could not draw are refused, with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motiongen_client import InvalidInput, Motion
from motiongen_client.errors import MotiongenError
from motiongen_tools.bvh import write_bvh
from motiongen_tools.npz import write_npz
from motiongen_tools.view.motion_files import read_upload


def test_a_bvh_file_of_an_unknown_skeleton_is_refused(tmp_path: Path, stick_motion: Motion) -> None:
    write_bvh(tmp_path / "walk.bvh", stick_motion)
    with pytest.raises(MotiongenError):
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
