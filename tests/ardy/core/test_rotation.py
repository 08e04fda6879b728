"""Rotations and kinematics: the golden vectors, and properties of the conversions."""

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
    local_quaternions,
    positions_from_global,
    skeleton_names,
)
from tests.ardy.conftest import GoldenModel, Vectors


def random_rotations(seed: int, *shape: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return rotation.matrix_from_6d(torch.randn(*shape, 6, generator=generator, dtype=torch.float64))


def test_conversions_match_the_golden_vectors(common_vectors: Callable[[str], Vectors]) -> None:
    vectors = common_vectors("rotations")
    vectors.check("out.matrix_to_six", rotation.matrix_to_6d(vectors["in.matrices"]))
    vectors.check("out.six_to_matrix", rotation.matrix_from_6d(vectors["in.six"]))
    vectors.check("out.axis_angle_to_matrix", rotation.axis_angle_to_matrix(vectors["in.axis_angle"]))
    vectors.check("out.matrix_to_quaternion_wxyz", rotation.matrix_to_quaternion(vectors["in.matrices"]))
    vectors.check("out.y_rotation", rotation.rotation_y(vectors["in.angles"]))


def test_kinematics_match_the_golden_vectors(golden: GoldenModel) -> None:
    skeleton, vectors = golden.model.skeleton, golden.vectors("kinematics")
    rotations, positions = forward_kinematics(skeleton, vectors["in.local_rot_mats"], vectors["in.root_positions"])
    vectors.check("out.global_rot_mats", rotations)
    vectors.check("out.posed_joints", positions)
    vectors.check("out.posed_joints", positions_from_global(skeleton, rotations, vectors["in.root_positions"]))
    vectors.check("out.local_from_global", global_to_local(skeleton, rotations))
    vectors.check("out.heading_angle", heading_angle(skeleton, positions))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_conversions_and_kinematics_can_be_inverted(seed: int) -> None:
    matrices = random_rotations(seed, 5)
    torch.testing.assert_close(rotation.matrix_from_6d(rotation.matrix_to_6d(matrices)), matrices)
    torch.testing.assert_close(rotation.quaternion_to_matrix(rotation.matrix_to_quaternion(matrices)), matrices)
    local = random_rotations(seed, 2, 27)
    skeleton = load_skeleton("core27")
    rotations, _ = forward_kinematics(skeleton, local, torch.zeros(2, 3, dtype=torch.float64))
    torch.testing.assert_close(global_to_local(skeleton, rotations), local)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.6, 3.1, torch.pi, 4.0])
def test_quaternions_are_exact_whichever_component_is_largest(axis: int, angle: float) -> None:
    turn = torch.zeros(3, dtype=torch.float64)
    turn[axis] = 1.0
    half = torch.tensor(angle / 2, dtype=torch.float64)
    expected = torch.cat([half.cos()[None], half.sin() * turn])
    found = rotation.matrix_to_quaternion(rotation.quaternion_to_matrix(expected))
    torch.testing.assert_close(found * (found @ expected).sign(), expected, atol=1e-12, rtol=0)
    assert found[found.abs().argmax()] > 0


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_local_quaternions_represent_the_local_rotations(seed: int) -> None:
    skeleton, rotations = load_skeleton("core27"), random_rotations(seed, 2, 3, 27)
    found = local_quaternions(skeleton, rotations).movedim(0, -1)
    torch.testing.assert_close(rotation.quaternion_to_matrix(found), global_to_local(skeleton, rotations))
    torch.testing.assert_close(found.norm(dim=-1), torch.ones(2, 3, 27, dtype=torch.float64))


@pytest.mark.parametrize("shape", [(), (5,), (2, 5), (2, 3, 5), (0, 5), (2, 0)])
def test_positions_are_computed_for_any_leading_dimensions(shape: tuple[int, ...]) -> None:
    skeleton, root = load_skeleton("core27"), torch.ones(*shape, 3, dtype=torch.float64)
    rotations, positions = forward_kinematics(skeleton, random_rotations(3, *shape, 27), root)
    torch.testing.assert_close(positions_from_global(skeleton, rotations, root), positions)


def test_positions_of_a_row_do_not_depend_on_other_rows() -> None:
    skeleton = load_skeleton("core27")
    rotations, root = random_rotations(4, 33, 41, 27).float(), torch.ones(33, 41, 3)
    together = positions_from_global(skeleton, rotations, root)
    for row in (0, 7, 32):
        alone = positions_from_global(skeleton, rotations[row : row + 1], root[row : row + 1])
        assert torch.equal(alone[0], together[row])


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


def test_every_skeleton_has_ordered_parents_and_its_root_at_the_origin() -> None:
    for name in skeleton_names():
        skeleton = load_skeleton(name)
        assert skeleton.parents[0] == -1
        assert all(parent < joint for joint, parent in enumerate(skeleton.parents))
        assert not skeleton.neutral_joints[0].any()


def test_unknown_names_are_refused_with_the_known_ones() -> None:
    with pytest.raises(UnknownSkeleton, match="core27"):
        load_skeleton("core28")
    with pytest.raises(UnknownJoint, match="Hips"):
        load_skeleton("core27").index("Tail")
