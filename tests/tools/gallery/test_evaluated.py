"""Takes of the evaluation come to the gallery as they were written, and other files are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.evaluate.context import Exhibit
from motiongen_ardy.evaluate.take import Result, Take
from motiongen_ardy.evaluate.take_files import write_takes
from motiongen_client import InvalidInput
from motiongen_tools.gallery.evaluated import read_takes
from tests.conftest import TINY_MODEL


def exhibit(layout: Representation, goals: tuple[tuple[int, float, float], ...], path: np.ndarray | None) -> Exhibit:
    joints, frames = layout.skeleton.num_joints, 6
    positions = torch.arange(frames * joints * 3, dtype=torch.float32).reshape(frames, joints, 3) / 100
    features = torch.zeros(frames, layout.contact_block.stop)
    features[:, layout.contact_block] = torch.tensor([1.0, 0.0, 1.0, 0.0])
    rotations = torch.eye(3).expand(frames, joints, 3, 3)
    take = Take("a clip", 0, frames, ((0, "walk"),))
    return Exhibit("waypoint: 0.01 m off", Result(take, features, positions, rotations, (0,)), goals, path)


def test_takes_come_as_they_were_written(tmp_path: Path) -> None:
    layout = load_checkpoint(TINY_MODEL).representation
    path = np.array([[0.0, 0.0], [0.0, 1.0]])
    shown = {"waypoint": [exhibit(layout, ((5, 1.0, 2.0),), None)], "path": [exhibit(layout, (), path)]}
    assert write_takes(shown, layout, tmp_path, 4) == 2
    (part, title, along), (other, _, there) = read_takes(tmp_path)
    assert (part, other, title) == ("path, 4 steps", "waypoint, 4 steps", "waypoint: 0.01 m off")
    np.testing.assert_array_equal(there.positions_m, shown["waypoint"][0].result.positions.numpy())
    assert there.contacts.tolist() == [[True, False, True, False]] * 6
    assert there.frame_rate_hz == 20
    assert len(there.feet) == 4
    assert [(goal.frame, goal.is_path) for goal in there.goals] == [(5, False)]
    assert [(goal.frame, goal.is_path) for goal in along.goals] == [(None, True)]


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="which has none"):
        read_takes(tmp_path)
    np.savez(tmp_path / "walk.npz", rows=np.zeros((2, 3)))
    with pytest.raises(InvalidInput, match=r"walk\.npz.*missing: title"):
        read_takes(tmp_path)
    (tmp_path / "walk.npz").write_bytes(b"no archive")
    with pytest.raises(InvalidInput, match="an NPZ file"):
        read_takes(tmp_path)
