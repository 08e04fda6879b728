"""The training set on disk: damage is reported, and an interrupted save changes nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from motiongen_ardy.data.dataset import CLIPS_FILE, MOTION_FILE, DatasetError, MotionDataset
from tests.ardy.train.clips import swinging_dataset


@pytest.mark.parametrize("kept", [0, 4, 1000, -200, -1])
def test_a_truncated_motion_file_is_reported(kept: int, tmp_path: Path) -> None:
    swinging_dataset().save(tmp_path)
    path = tmp_path / MOTION_FILE
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(DatasetError, match=r"motion\.npz: cannot be read: .*; build the set again"):
        MotionDataset.load(tmp_path)


def test_a_corrupt_motion_file_is_reported(tmp_path: Path) -> None:
    swinging_dataset().save(tmp_path)
    path = tmp_path / MOTION_FILE
    content = bytearray(path.read_bytes())
    content[5000:5100] = bytes(100)
    path.write_bytes(content)
    with pytest.raises(DatasetError, match="build the set again"):
        MotionDataset.load(tmp_path)


def test_an_interrupted_save_leaves_the_motion_file_unchanged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dataset = swinging_dataset()
    dataset.save(tmp_path)
    before = (tmp_path / MOTION_FILE).read_bytes()

    def interrupted(file: object, **_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        dataset.save(tmp_path)
    assert (tmp_path / MOTION_FILE).read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([MOTION_FILE, CLIPS_FILE])
