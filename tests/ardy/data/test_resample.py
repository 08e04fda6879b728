"""Other frame rates: which frames there are, where they lie, and how poses between two frames are made."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.rotation import rotation_vector
from motiongen_ardy.data.bvh import axis_rotation
from motiongen_ardy.data.resample import resample, resampled_length


def turning(num_frames: int, step_rad: float) -> tuple[Tensor, Tensor]:
    """A joint (T, 1, 3, 3) that turns about y by step_rad a frame, and a point (T, 1, 3) a metre further each frame."""
    frames = torch.arange(num_frames, dtype=torch.float64)
    return axis_rotation(1, step_rad * frames[:, None]), frames[:, None, None] * torch.tensor([1.0, 0.0, -2.0])


@pytest.mark.parametrize(
    ("num_frames", "source_fps", "target_fps", "length"),
    [
        (1, 120, 20, 1),
        (6, 120, 20, 1),
        (7, 120, 20, 2),
        (121, 120, 20, 21),
        (31, 30, 25, 26),
        (30, 30, 25, 25),
        (11, 20, 60, 31),
        (4, 0.3, 0.1, 2),  # 3 * 0.1 / 0.3 is below 1 by rounding
    ],
)
def test_frames_reach_to_the_last_source_frame_and_not_beyond(
    num_frames: int, source_fps: float, target_fps: float, length: int
) -> None:
    assert resampled_length(num_frames, source_fps, target_fps) == length


@pytest.mark.parametrize(("source_fps", "target_fps"), [(120, 20), (30, 25), (20, 60), (30, 100), (25, 25)])
def test_frames_lie_evenly_on_the_path_from_the_first_to_the_last(source_fps: float, target_fps: float) -> None:
    step_rad = 0.1
    made, points = resample(*turning(31, step_rad), source_fps, target_fps)
    at = torch.arange(len(made), dtype=torch.float64) * source_fps / target_fps
    assert at[-1] == pytest.approx(30, abs=source_fps / target_fps)
    torch.testing.assert_close(points[:, 0], at[:, None] * torch.tensor([1.0, 0.0, -2.0]), atol=1e-9, rtol=0)
    torch.testing.assert_close(made[:, 0], axis_rotation(1, step_rad * at), atol=1e-9, rtol=0)


def test_a_pose_that_is_kept_is_not_mixed_with_the_next() -> None:
    """At 0.3 source frames a frame, the tenth falls on the third source frame but for rounding, on one side of it."""
    rotations, points = turning(31, 2.0)
    made, placed = resample(rotations, points, 30, 100)
    torch.testing.assert_close(made[::10], rotations[::3], atol=1e-9, rtol=0)
    torch.testing.assert_close(placed[::10], points[::3], atol=1e-9, rtol=0)
    assert torch.equal(placed[0], points[0])


@pytest.mark.parametrize("step_rad", [math.radians(170), -math.radians(170)])
def test_a_joint_turns_the_short_way(step_rad: float) -> None:
    made, _ = resample(*turning(8, step_rad), 20, 40)
    steps = rotation_vector(made[:-1].transpose(-1, -2) @ made[1:])[:, 0, 1]
    torch.testing.assert_close(steps, torch.full_like(steps, step_rad / 2), atol=1e-6, rtol=0)
