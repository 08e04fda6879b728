"""The values that targets accept, and that targets keep copies of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.constraint_values import ConstraintError
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, Representation
from motiongen_ardy.core.residuals import residuals
from motiongen_ardy.core.skeleton import JointsMismatch, load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.formats.constraints import pose_constraint, read_constraints, write_constraints
from tests.ardy.formats.motions import random_motion

CORE = load_skeleton("core27")
POSE = torch.tensor(CORE.neutral_joints + np.array([1.0, 0.9, 2.0])).float()


def layout_of(name: str) -> Representation:
    skeleton = load_skeleton(name)
    width = skeleton.feature_dim + LOCAL_ROOT_WIDTH
    return Representation(skeleton, 20, Stats(torch.zeros(width), torch.ones(width)))


def test_later_changes_to_the_arrays_given_do_not_affect_targets() -> None:
    targets = Targets(CORE)
    place, pose, turn = np.zeros((1, 2), np.float32), POSE[None].clone(), torch.eye(3)[None]
    for frame in (3, 5):
        place[0] = frame, -frame
        targets.add_waypoints([frame], place)
    targets.add_keyframes([8], pose)
    targets.add_joints(9, [0], pose[0, :1], turn)
    pose.zero_()
    turn.zero_()
    assert [targets.ground[frame].tolist() for frame in (3, 5)] == [[3, -3], [5, -5]]
    assert np.array_equal(targets.positions[8, 4], POSE[4])
    assert np.array_equal(targets.positions[9, 0], POSE[0])
    assert np.array_equal(targets.rotations[9, 0], np.eye(3))


def read_only(values: Tensor) -> np.ndarray:
    array = values.numpy().copy()
    array.setflags(write=False)
    return array


@pytest.mark.parametrize(
    "given",
    [
        lambda pose: pose.double(),
        lambda pose: pose.clone().requires_grad_(True),
        lambda pose: pose.transpose(0, 1).contiguous().transpose(0, 1),
        lambda pose: pose.numpy().astype(np.float64),
        lambda pose: pose.flip(0).numpy()[::-1],
        lambda pose: np.asfortranarray(pose.numpy()),
        read_only,
    ],
    ids=["float64", "with a graph", "strided", "numpy float64", "reversed", "fortran", "read-only"],
)
def test_arrays_may_be_of_any_type_and_memory_layout(given: Callable[[Tensor], Any]) -> None:
    poses = torch.stack([POSE, POSE + torch.tensor([0.0, 0.0, 1.0])])
    plain, other = Targets(CORE), Targets(CORE)
    plain.add_keyframes([2, 4], poses)
    other.add_keyframes([2, 4], given(poses))
    layout = layout_of("core27")
    assert torch.equal(other.fill(layout, 0, 6)[0], plain.fill(layout, 0, 6)[0])


def test_targets_stay_on_the_cpu_whatever_the_default_device() -> None:
    with torch.device("meta"):
        targets = Targets(CORE)
        targets.add_keyframes([2], POSE[None].numpy())
    assert targets.heading[2].tolist() == pytest.approx([1, 0], abs=1e-6)


@pytest.mark.parametrize("frames", [np.array([2, 4]), torch.tensor([2, 4]), range(2, 5, 2), (2, 4)])
def test_frames_may_be_any_sequence_of_integers(frames: Any) -> None:
    targets = Targets(CORE)
    targets.add_waypoints(frames, torch.ones(2, 2), torch.zeros(2))
    assert targets.frames == {2, 4}
    assert all(type(frame) is int for frame in (*targets.ground, *targets.heading))
    assert not targets.copy().frames ^ {2, 4}


@pytest.mark.parametrize(
    "add",
    [
        lambda targets, frame: targets.add_waypoints([frame], torch.zeros(1, 2)),
        lambda targets, frame: targets.add_heading([frame], torch.zeros(1)),
        lambda targets, frame: targets.add_keyframes([frame], POSE[None]),
        lambda targets, frame: targets.add_end_effectors(
            [frame], ["Hips"], POSE[None], torch.eye(3).expand(1, CORE.num_joints, 3, 3)
        ),
        lambda targets, frame: targets.add_joints(frame, [0], POSE[:1]),
        lambda targets, frame: targets.add_rotations(frame, [0], torch.eye(3)[None]),
    ],
)
@pytest.mark.parametrize(
    ("frame", "message"), [(-1, "hold -1; they are counted from 0"), (1.5, "must be a whole number"), ("1", "whole")]
)
def test_frames_that_are_negative_or_not_integers_are_refused(
    add: Callable[[Targets, Any], None], frame: Any, message: str
) -> None:
    targets = Targets(CORE)
    with pytest.raises(ConstraintError, match=message):
        add(targets, frame)
    assert not targets.frames


@pytest.mark.parametrize(
    "matrix", [torch.zeros(3, 3), 2 * torch.eye(3), torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.ones(3, 3)]
)
def test_a_matrix_that_is_not_a_rotation_is_refused(matrix: Tensor) -> None:
    targets = Targets(CORE)
    turns = torch.eye(3).repeat(1, CORE.num_joints, 1, 1)
    turns[0, 5] = matrix
    for add in (
        lambda: targets.add_rotations(2, [4, 5], turns[0, 4:6]),
        lambda: targets.add_joints(2, [4, 5], POSE[4:6], turns[0, 4:6]),
        lambda: targets.add_end_effectors([2], ["Hips"], POSE[None], turns),
    ):
        with pytest.raises(ConstraintError, match="a matrix that is no rotation; give orthonormal ones"):
            add()
    assert not targets.frames


def test_a_number_too_large_for_float32_is_refused_without_a_warning() -> None:
    with pytest.raises(ConstraintError, match="infinite"):
        Targets(CORE).add_waypoints([0], np.array([[1e300, 0.0]]))


def test_targets_of_another_skeleton_are_refused() -> None:
    targets = Targets(load_skeleton("g134"))
    targets.add_joints(2, [0, 30], POSE[:2])
    with pytest.raises(ConstraintError, match="targets are of g134, the features of core27"):
        targets.fill(layout_of("core27"), 0, 4)
    with pytest.raises(JointsMismatch, match="rotations of 27 joints; the skeleton g134 has 34"):
        residuals(random_motion(CORE, 4, seed=1).motion, [targets])


def test_pose_constraints_are_made_only_at_frames_of_the_motion(tmp_path: Any) -> None:
    motion = random_motion(CORE, 6, seed=1).motion
    asked = pose_constraint(motion, np.array([1, 4]))  # type: ignore[arg-type]
    write_constraints(tmp_path / "poses.json", [asked])
    (again,) = read_constraints(tmp_path / "poses.json", CORE)
    assert again.frames == (1, 4)
    for frame in (-1, 6):
        with pytest.raises(ConstraintError, match=f"frames hold {frame}"):
            pose_constraint(motion, [frame])
