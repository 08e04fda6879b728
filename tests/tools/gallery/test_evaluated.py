"""Takes of the evaluation: the gallery reads them as they were written, and refuses other files."""

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
from motiongen_tools.gallery.evaluated import FORMAT, read_takes
from tests.conftest import TINY_MODEL


def exhibit(layout: Representation, goals: tuple[tuple[int, float, float], ...], path: np.ndarray | None) -> Exhibit:
    joints, frames = layout.skeleton.num_joints, 6
    positions = torch.arange(frames * joints * 3, dtype=torch.float32).reshape(frames, joints, 3) / 100
    features = torch.zeros(frames, layout.contact_block.stop)
    features[:, layout.contact_block] = torch.tensor([1.0, 0.0, 1.0, 0.0])
    rotations = torch.eye(3).expand(frames, joints, 3, 3)
    take = Take("a clip", 0, frames, ((0, "walk"),))
    return Exhibit("waypoint: 0.01 m off", Result(take, features, positions, rotations, (0,)), goals, path)


def test_takes_are_read_as_they_were_written(tmp_path: Path) -> None:
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


def good(path: Path, **other: object) -> bytes:
    """Write a take of two joints, with the given arrays in place of its own. Returns the file's bytes."""
    arrays: dict[str, object] = {
        "format": FORMAT, "title": "t", "part": "p", "joint_names": np.array(["Hips", "Head"]), "parents": [-1, 0],
        "frame_rate_hz": 20, "positions_m": np.zeros((3, 2, 3)), "contacts": np.zeros((3, 4)),
        "goals": np.zeros((0, 3)), "path_m": np.zeros((0, 2)),
    }  # fmt: skip
    np.savez(path, **{**arrays, **other})
    return path.read_bytes()


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path: Path) -> None:
    """As if the evaluation had been ended while it wrote."""
    path = tmp_path / "take.npz"
    whole = good(path)
    assert len(read_takes(tmp_path)) == 1
    for length in (0, 1, 4, 30, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InvalidInput, match=r"take\.npz.*an NPZ file"):
            read_takes(tmp_path)


@pytest.mark.parametrize(
    "other",
    [
        {"goals": np.zeros(3)},
        {"goals": np.full((1, 3), np.inf)},
        {"path_m": np.float32(1)},
        {"joint_names": np.array("Hips")},
        {"parents": np.array(["a", "b"])},
        {"frame_rate_hz": np.array([20, 20])},
        {"positions_m": np.array(["a"])},
    ],
)
def test_arrays_of_other_shapes_and_types_are_refused(other: dict[str, object], tmp_path: Path) -> None:
    good(tmp_path / "take.npz", **other)
    with pytest.raises(InvalidInput, match=r"take\.npz"):
        read_takes(tmp_path)
