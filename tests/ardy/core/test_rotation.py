"""Rotations and kinematics against the golden vectors and against each other."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.core import rotation
from motiongen_ardy.core.representation import heading_angle
from motiongen_ardy.core.skeleton import (
    UnknownJoint,
    UnknownSkeleton,
    forward_kinematics,
    global_to_local,
    load_skeleton,
    positions_from_global,
    skeleton_names,
)
from tests.ardy.conftest import GoldenModel, Vectors


def random_rotations(seed: int, *shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return rotation.matrix_from_6d(torch.randn(*shape, 6, generator=generator, dtype=torch.float64))


def test_every_conversion(common_vectors: Callable[[str], Vectors]) -> None:
    vectors = common_vectors("rotations")
    vectors.check("out.matrix_to_six", rotation.matrix_to_6d(vectors["in.matrices"]))
    vectors.check("out.six_to_matrix", rotation.matrix_from_6d(vectors["in.six"]))
    vectors.check("out.axis_angle_to_matrix", rotation.axis_angle_to_matrix(vectors["in.axis_angle"]))
    vectors.check("out.matrix_to_quaternion_wxyz", rotation.matrix_to_quaternion(vectors["in.matrices"]))
    vectors.check("out.y_rotation", rotation.rotation_y(vectors["in.angles"]))


def test_kinematics(golden: GoldenModel) -> None:
    skeleton, vectors = golden.model.skeleton, golden.vectors("kinematics")
    rotations, positions = forward_kinematics(skeleton, vectors["in.local_rot_mats"], vectors["in.root_positions"])
    vectors.check("out.global_rot_mats", rotations)
    vectors.check("out.posed_joints", positions)
    vectors.check("out.posed_joints", positions_from_global(skeleton, rotations, vectors["in.root_positions"]))
    vectors.check("out.local_from_global", global_to_local(skeleton, rotations))
    vectors.check("out.heading_angle", heading_angle(skeleton, positions))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_round_trips(seed: int) -> None:
    matrices = random_rotations(seed, 5)
    torch.testing.assert_close(rotation.matrix_from_6d(rotation.matrix_to_6d(matrices)), matrices)
    torch.testing.assert_close(rotation.quaternion_to_matrix(rotation.matrix_to_quaternion(matrices)), matrices)
    local = random_rotations(seed, 2, 27)
    skeleton = load_skeleton("core27")
    rotations, _ = forward_kinematics(skeleton, local, torch.zeros(2, 3, dtype=torch.float64))
    torch.testing.assert_close(global_to_local(skeleton, rotations), local)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000), fraction=st.floats(0, 1))
def test_slerp_turns_at_constant_rate_along_the_shorter_arc(seed: int, fraction: float) -> None:
    start, end = rotation.matrix_to_quaternion(random_rotations(seed, 2))
    middle = rotation.slerp(start, end, torch.tensor(fraction, dtype=torch.float64))
    whole = 2 * torch.acos((start @ end).abs().clamp(max=1))
    part = 2 * torch.acos((start @ middle).abs().clamp(max=1))
    assert abs(float(part - fraction * whole)) < 1e-4
    torch.testing.assert_close(middle.norm(), torch.tensor(1.0, dtype=torch.float64))


def test_a_quarter_turn_about_y_faces_plus_x() -> None:
    facing = rotation.rotation_y(torch.tensor(torch.pi / 2)) @ torch.tensor([0.0, 0.0, 1.0])
    torch.testing.assert_close(facing, torch.tensor([1.0, 0.0, 0.0]), atol=1e-6, rtol=0)


def test_every_skeleton_is_sound() -> None:
    for name in skeleton_names():
        skeleton = load_skeleton(name)
        assert skeleton.parents[0] == -1
        assert all(parent < joint for joint, parent in enumerate(skeleton.parents))
        assert not skeleton.neutral_joints[0].any()


def test_unknown_names_are_refused_with_what_is_known() -> None:
    with pytest.raises(UnknownSkeleton, match="core27"):
        load_skeleton("core28")
    with pytest.raises(UnknownJoint, match="Hips"):
        load_skeleton("core27").index("Tail")
