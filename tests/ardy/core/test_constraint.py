from __future__ import annotations

import json
from typing import Any

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import ConstraintError, Targets, limb_chains
from motiongen_ardy.core.rotation import matrix_to_6d, rotation_y
from motiongen_ardy.core.skeleton import forward_kinematics, load_skeleton
from motiongen_ardy.formats.constraints import constraint_targets, parse_constraints

CASES = (
    "root2d", "root2d_heading", "fullbody", "fullbody_shifted_root", "left_hand", "right_hand", "left_foot",
    "right_foot", "end_effector", "several", "conflict", "empty",
)  # fmt: skip


@pytest.fixture(scope="module")
def layout(golden: Any) -> Any:
    return golden.model.representation


@pytest.fixture(scope="module")
def pose(layout: Any) -> tuple[Tensor, Tensor]:
    """Global rotations (1, J, 3, 3) and positions (1, J, 3) of a turned neutral pose that stands at x 1, z 2."""
    skeleton = layout.skeleton
    local = torch.eye(3).repeat(1, skeleton.num_joints, 1, 1)
    local[:, 0] = rotation_y(torch.tensor([0.5]))
    rotations, positions = forward_kinematics(skeleton, local, torch.tensor([[1.0, 0.9, 2.0]]))
    return rotations, positions


def columns(mask: Tensor, frame: int) -> set[int]:
    return set(mask[frame].nonzero().flatten().tolist())


def limb_columns(layout: Any, joints: tuple[int, ...]) -> set[int]:
    start = layout.position_block.start
    return {start + 3 * (joint - 1) + axis for joint in joints if joint for axis in range(3)}


def turn_columns(layout: Any, joint: int) -> set[int]:
    return {layout.rotation_block.start + 6 * joint + number for number in range(6)}


@pytest.mark.parametrize("case", CASES)
def test_conditions_match_the_golden_vectors(golden: Any, case: str) -> None:
    vectors = golden.vectors("conditions")
    listed = json.loads((golden.folder / "vectors" / "conditions.json").read_text())
    skeleton = golden.model.skeleton
    targets = constraint_targets(skeleton, parse_constraints(listed["cases"][case], skeleton))
    observed, mask = targets.fill(golden.model.representation, 0, listed["frames"])
    vectors.check(f"{case}.out.observed", observed)
    vectors.check_equal(f"{case}.out.mask", mask)
    normalized, same_mask = targets.observe(golden.model.representation, 0, listed["frames"])
    vectors.check(f"{case}.out.observed_normalized", normalized)
    assert torch.equal(same_mask, mask)


def test_a_waypoint_constrains_ground_position_and_optional_heading(layout: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([2, 5], torch.tensor([[1.0, 2.0], [3.0, 4.0]]))
    targets.add_waypoints([7], torch.tensor([[5.0, 6.0]]), torch.tensor([torch.pi / 2]))
    observed, mask = targets.fill(layout, 0, 8)
    assert columns(mask, 2) == {0, 2}
    assert columns(mask, 7) == {0, 2, 3, 4}
    assert observed[5, [0, 2]].tolist() == [3, 4]
    assert observed[7, 3:5].tolist() == pytest.approx([0, 1], abs=1e-6)
    assert targets.frames == {2, 5, 7}
    assert mask.sum() == 8


def test_frames_are_absolute(layout: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_waypoints([10, 12, 99], torch.ones(3, 2))
    _, mask = targets.fill(layout, 11, 4)
    assert mask.any(1).tolist() == [False, True, False, False]


def test_a_keyframe_constrains_positions_but_no_rotation(layout: Any, pose: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_keyframes([0], pose[1])
    observed, mask = targets.fill(layout, 0, 1)
    joints = tuple(range(layout.skeleton.num_joints))
    assert columns(mask, 0) == {0, 1, 2, 3, 4} | limb_columns(layout, joints)
    positions = layout.positions_block(observed)[0]
    torch.testing.assert_close(positions[1:], pose[1][0, 1:])
    assert torch.atan2(observed[0, 4], observed[0, 3]).item() == pytest.approx(0.5, abs=1e-5)


def test_a_shifted_ground_position_moves_the_root_and_not_the_pose(layout: Any, pose: Any) -> None:
    plain, shifted = Targets(layout.skeleton), Targets(layout.skeleton)
    plain.add_keyframes([0], pose[1])
    shifted.add_keyframes([0], pose[1], torch.tensor([[-3.0, 4.0]]))
    difference = shifted.fill(layout, 0, 1)[0] - plain.fill(layout, 0, 1)[0]
    assert columns(difference, 0) == {0, 2}


@pytest.mark.parametrize("limb", ["LeftHand", "RightHand", "LeftFoot", "RightFoot"])
def test_an_end_effector_constrains_its_chain_and_the_root(layout: Any, pose: Any, limb: str) -> None:
    rotations, positions = pose
    targets = Targets(layout.skeleton)
    targets.add_end_effectors([0], [limb, "Hips"], positions, rotations)
    observed, mask = targets.fill(layout, 0, 1)
    chain = limb_chains(layout.skeleton)[limb]
    turned = turn_columns(layout, chain[0]) | turn_columns(layout, 0)
    assert columns(mask, 0) == {0, 1, 2, 3, 4} | limb_columns(layout, chain) | turned
    first = layout.rotation_block.start + 6 * chain[0]
    torch.testing.assert_close(observed[0, first : first + 6], matrix_to_6d(rotations[0, chain[0]]))


def test_a_limb_without_hips_keeps_its_offset_from_a_moved_root(layout: Any, pose: Any) -> None:
    rotations, positions = pose
    plain, shifted, later, copied = (Targets(layout.skeleton) for _ in range(4))
    plain.add_end_effectors([0], ["LeftHand"], positions, rotations)
    shifted.add_end_effectors([0], ["LeftHand"], positions, rotations, torch.tensor([[-3.0, 4.0]]))
    later.add_end_effectors([0], ["LeftHand"], positions, rotations)
    later.add_waypoints([0], torch.tensor([[-3.0, 4.0]]))
    copied.add_all(shifted.copy())
    expected = plain.fill(layout, 0, 1)[0]
    for targets in (shifted, later, copied):
        assert columns(targets.fill(layout, 0, 1)[0] - expected, 0) == {0, 2}


def test_a_keyframe_root_takes_precedence_over_that_of_a_limb_without_hips(layout: Any, pose: Any) -> None:
    rotations, positions = pose
    targets, expected = Targets(layout.skeleton), Targets(layout.skeleton)
    moved = positions + torch.tensor([5.0, 0.0, 0.0])
    targets.add_keyframes([0], moved)
    targets.add_end_effectors([0], ["LeftHand"], positions, rotations)
    expected.add_keyframes([0], moved)
    chain = limb_chains(layout.skeleton)["LeftHand"]
    expected.add_joints(0, chain, positions[0, list(chain)])
    seen, told = (each.fill(layout, 0, 1)[0][:, layout.position_block] for each in (targets, expected))
    assert torch.equal(seen, told)


def test_joint_targets_leave_the_heading_free(layout: Any, pose: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_joints(0, [0, 5], pose[1][0, [0, 5]])
    targets.add_joints(1, [0, 5], pose[1][0, [0, 5]], pose[0][0, [0, 5]])
    _, mask = targets.fill(layout, 0, 2)
    assert columns(mask, 0) == {0, 1, 2} | limb_columns(layout, (5,))
    assert columns(mask, 1) == columns(mask, 0) | turn_columns(layout, 0) | turn_columns(layout, 5)


def test_a_later_target_replaces_an_earlier_one(layout: Any, pose: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_keyframes([0], pose[1])
    targets.add_waypoints([0], torch.tensor([[8.0, 9.0]]))
    observed, mask = targets.fill(layout, 0, 1)
    assert observed[0, [0, 2]].tolist() == [8, 9]
    assert mask[0, layout.position_block].all(), "a waypoint leaves the pose of a keyframe"


def test_joint_targets_without_a_root_position_are_refused(layout: Any, pose: Any) -> None:
    targets = Targets(layout.skeleton)
    targets.add_joints(3, [5], pose[1][0, [5]])
    with pytest.raises(ConstraintError, match=r"frame 3 .*where the root is"):
        targets.fill(layout, 0, 8)


def test_joint_targets_are_relative_to_a_waypoint_at_the_same_frame(layout: Any, pose: Any) -> None:
    whole, alone = Targets(layout.skeleton), Targets(layout.skeleton)
    whole.add_joints(3, [0, 5], pose[1][0, [0, 5]])
    alone.add_joints(3, [5], pose[1][0, [5]])
    alone.add_waypoints([3], pose[1][0, 0, [0, 2]][None])
    first = layout.position_block.start + 3 * 4
    columns = slice(first, first + 3)
    (seen, asked), (expected, _) = alone.fill(layout, 0, 8), whole.fill(layout, 0, 8)
    assert torch.equal(seen[3, columns], expected[3, columns])
    assert asked[3, columns].all()
    assert not asked[3, 1], "the root's height stays free"


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (lambda t, r, p: t.add_waypoints([0], torch.zeros(2, 2)), r"shape \(2, 2\); give \(1, 2\)"),
        (lambda t, r, p: t.add_waypoints([0], torch.zeros(1, 2), torch.zeros(3)), "headings have shape"),
        (lambda t, r, p: t.add_waypoints([0], torch.tensor([[float("nan"), 0]])), "NaN or infinite"),
        (lambda t, r, p: t.add_waypoints([0], torch.tensor([[float("inf"), 0]])), "NaN or infinite"),
        (lambda t, r, p: t.add_keyframes([0], p[:, 1:]), "joint positions have shape"),
        (lambda t, r, p: t.add_keyframes([0, 1], p), "joint positions have shape"),
        (lambda t, r, p: t.add_keyframes([0], p, torch.zeros(2)), "ground positions have shape"),
        (lambda t, r, p: t.add_end_effectors([0], ["Tail"], p, r), "LeftHand, RightHand, LeftFoot, RightFoot, Hips"),
        (lambda t, r, p: t.add_end_effectors([0], [], p, r), "name one or more"),
        (lambda t, r, p: t.add_end_effectors([0], ["Hips"], p, r[:, 1:]), "joint rotations have shape"),
        (lambda t, r, p: t.add_joints(0, [0, 500], p[0, :2]), "not all in 0"),
        (lambda t, r, p: t.add_joints(0, [0], p[0, :2]), "joint positions have shape"),
        (lambda t, r, p: t.add_joints(0, [0], p[0, :1], r[0, :1] / 0), "joint rotations hold NaN"),
    ],
)
def test_invalid_targets_are_refused(layout: Any, pose: Any, add: Any, message: str) -> None:
    targets = Targets(layout.skeleton)
    with pytest.raises(ConstraintError, match=message):
        add(targets, *pose)
    assert not targets.frames, "a refused target leaves nothing behind"


def test_requested_targets_override_those_that_follow_from_a_velocity() -> None:
    skeleton = load_skeleton("core27")
    targets = Targets(skeleton)
    targets.add_lead(10, torch.zeros(9, 2), torch.zeros(9), 4)
    assert targets.planned == targets.faced == {10, 14, 18}
    asked = Targets(skeleton)
    asked.add_waypoints([14], torch.ones(1, 2))
    asked.add_heading([18], torch.ones(1))
    targets.add_all(asked)
    targets.add_joints(10, [0], torch.ones(1, 3))
    assert (targets.planned, targets.faced) == ({18}, {10, 14})
    assert [targets.ground[frame].tolist() for frame in (10, 14, 18)] == [[1, 1], [1, 1], [0, 0]]
    exact = Targets(skeleton)
    exact.add_lead(10, torch.zeros(3, 2), None, 1)
    assert (sorted(exact.ground), exact.planned, exact.heading) == ([10, 11, 12], set(), {})
