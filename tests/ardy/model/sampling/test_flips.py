"""Flips: a body that flips is turned back, and the poses around a far flip are interpolated."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.core.rotation import axis_angle_to_matrix
from motiongen_ardy.model.sampling import flips as module
from motiongen_ardy.model.sampling.flips import BRIDGED_FRAMES, FAR_RAD, FLIP_RAD, undo_flips
from motiongen_ardy.model.sampling.pose import Poses
from tests.ardy.model.sampling.test_facing import shown, standing


def flipping(flips: dict[int, float], num_frames: int = 20) -> tuple[Poses, torch.Tensor]:
    """A body that turns with its root and flips by these radians at these frames, and the headings of its root."""
    poses = standing(num_frames)
    turn = torch.linspace(0, 1.5, num_frames)
    by = torch.zeros(num_frames)
    for frame, angle in flips.items():
        by[frame] += angle
    poses.turn_about_up((turn + by.cumsum(0))[None])
    return poses, torch.stack([turn.cos(), turn.sin()], dim=-1)[None]


def without_flips(poses: Poses, heading: torch.Tensor) -> Poses:
    """All frames with their flips undone; the first frame is the history."""
    before, after = poses.only(0), Poses(poses.layout, poses.rotations[:, 1:], poses.root[:, 1:], poses.contacts[:, 1:])
    undo_flips(before, after, heading)
    return before.then(after)


def steps_of(poses: Poses) -> torch.Tensor:
    steps = shown(poses).diff()
    return torch.atan2(steps.sin(), steps.cos()).abs()


@given(
    st.dictionaries(
        st.integers(1, 19), st.floats(FLIP_RAD + 0.01, math.pi - 0.1) | st.floats(0.1 - math.pi, -FLIP_RAD - 0.01)
    )
)
def test_a_body_that_flips_is_turned_back_to_its_root(flips: dict[int, float]) -> None:
    poses, heading = flipping(flips)
    straight, _ = flipping({})
    found = without_flips(poses, heading)
    torch.testing.assert_close(found.rotations, straight.rotations, atol=1e-5, rtol=0)
    assert float(steps_of(found).max()) < FLIP_RAD


def test_a_gradual_turn_without_the_root_is_not_a_flip() -> None:
    poses = standing(20)
    poses.turn_about_up(torch.linspace(0, 18 * FLIP_RAD, 20)[None])
    before = poses.rotations.clone()
    found = without_flips(poses, torch.tensor([1.0, 0.0]).expand(1, 20, 2))
    assert torch.equal(found.rotations, before)


def test_a_body_that_lies_on_its_side_is_left_unchanged() -> None:
    poses = standing(20)
    side = axis_angle_to_matrix(torch.tensor([0.0, 0.0, 1.5]))
    rolled = axis_angle_to_matrix(0.1 * torch.sin(torch.arange(20.0))[:, None] * torch.tensor([1.0, 0.0, 0.0]))
    poses.rotations = (rolled @ side)[None, :, None] @ poses.rotations
    before = poses.rotations.clone()
    assert float(steps_of(poses).max()) > FLIP_RAD, "its hip line is upright and has no heading"
    found = without_flips(poses, torch.tensor([1.0, 0.0]).expand(1, 20, 2))
    assert torch.equal(found.rotations, before)


def with_an_arm_thrown(poses: Poses, frames: list[int]) -> Poses:
    """The same poses, with the right arm turned elsewhere at each of these frames."""
    arm = poses.layout.skeleton.index("RightArm")
    for frame in frames:
        thrown = axis_angle_to_matrix(torch.tensor([1.5 + 0.4 * frame, -0.7 * frame, 0.9]))
        poses.rotations[:, frame, arm] = thrown @ poses.rotations[:, frame, arm]
    return poses


@pytest.mark.parametrize("flip", [1, 2, 8, 15])
def test_poses_around_a_far_flip_are_interpolated_across_it(flip: int) -> None:
    poses, heading = flipping({flip: FAR_RAD + 1.0})
    straight, _ = flipping({})
    about = [frame for frame in range(1, 20) if abs(frame - flip) <= BRIDGED_FRAMES]
    found = without_flips(with_an_arm_thrown(poses, about), heading)
    torch.testing.assert_close(found.rotations, straight.rotations, atol=1e-5, rtol=0)


def test_poses_around_a_near_flip_change_only_their_heading() -> None:
    poses, heading = flipping({8: FAR_RAD - 0.1})
    thrown = with_an_arm_thrown(poses, [7, 8])
    as_seen_from_hips = thrown.rotations[:, :, :1].mT @ thrown.rotations
    found = without_flips(thrown, heading).rotations
    torch.testing.assert_close(found[:, :, :1].mT @ found, as_seen_from_hips, atol=1e-5, rtol=0)
    torch.testing.assert_close(found[:, :, 0], flipping({})[0].rotations[:, :, 0], atol=1e-5, rtol=0)


def test_a_far_flip_at_the_window_end_is_turned_back_without_a_later_pose() -> None:
    poses, heading = flipping({18: FAR_RAD + 1.0})
    straight, _ = flipping({})
    found = without_flips(with_an_arm_thrown(poses, [18]), heading)
    torch.testing.assert_close(found.rotations[:, 19], straight.rotations[:, 19], atol=1e-5, rtol=0)
    assert float(steps_of(found).max()) < FLIP_RAD


def test_a_row_does_not_depend_on_the_others_in_its_batch() -> None:
    rows = [flipping({8: 2.0}), flipping({}), flipping({3: -2.5, 12: 0.5})]
    layout = rows[0][0].layout
    together = Poses(
        layout, *(torch.cat(parts) for parts in zip(*((p.rotations, p.root, p.contacts) for p, _ in rows), strict=True))
    )
    found = without_flips(together, torch.cat([heading for _, heading in rows]))
    for row, (poses, heading) in enumerate(rows):
        assert torch.equal(found.rotations[row : row + 1], without_flips(poses, heading).rotations)
    assert torch.equal(found.rotations[1], rows[1][0].rotations[0]), "a row without flips is unchanged, bit for bit"


def test_interpolating_all_rows_at_once_as_on_a_gpu_gives_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    poses, heading = flipping({3: 2.5, 12: -1.5, 18: 1.0})
    apart = without_flips(poses, heading).rotations
    monkeypatch.setattr(module, "_rows_of", lambda far: None)
    assert torch.equal(without_flips(poses, heading).rotations, apart)


def test_a_joint_with_opposed_axes_across_a_flip_keeps_its_own_rotations() -> None:
    poses, heading = flipping({8: FAR_RAD + 1.0})
    arm = poses.layout.skeleton.index("RightArm")
    over = axis_angle_to_matrix(torch.tensor([0.0, 0.0, 3.0]))
    poses.rotations[:, 8:, arm] = poses.rotations[:, 8:, 0] @ over
    own = poses.rotations[:, :, 0].mT @ poses.rotations[:, :, arm]
    found = without_flips(poses, heading).rotations
    torch.testing.assert_close(found[:, :, 0].mT @ found[:, :, arm], own, atol=1e-5, rtol=0)
