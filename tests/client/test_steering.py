"""Sticks relative to the camera, and corners of drawn lines within a given distance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_client import InvalidInput, camera_relative, drawn_corners, stick_velocity


@pytest.mark.parametrize(
    ("right", "forward", "camera", "velocity"),
    [
        (0.0, 1.0, 0.0, (0.0, 2.0)),  # along +Z
        (1.0, 0.0, 0.0, (-2.0, 0.0)),  # +X is to the left
        (0.0, 1.0, math.pi / 2, (2.0, 0.0)),
        (1.0, 0.0, math.pi / 2, (0.0, 2.0)),
        (1.0, 1.0, 0.0, (-math.sqrt(2), math.sqrt(2))),  # no faster in a corner
        (0.1, 0.1, 0.0, (0.0, 0.0)),
    ],
)
def test_stick_velocity_is_relative_to_the_camera(
    right: float, forward: float, camera: float, velocity: tuple[float, float]
) -> None:
    assert stick_velocity(right, forward, camera_heading_rad=camera, speed_mps=2.0) == pytest.approx(velocity, abs=1e-9)


def test_speed_rises_from_zero_beyond_the_dead_zone() -> None:
    assert math.hypot(*stick_velocity(0.151, 0.0)) < 0.01


@pytest.mark.parametrize("wrong", [{"right": math.nan}, {"dead_zone": 1.0}, {"camera_heading_rad": math.inf}])
def test_invalid_stick_values_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        stick_velocity(**{"right": 0.0, "forward": 1.0, **wrong})


def test_place_is_relative_to_the_camera() -> None:
    assert camera_relative(1.0, 2.0, math.pi / 2) == pytest.approx((2.0, 1.0))


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=40), st.floats(0.05, 2.0))
def test_no_drawn_point_is_farther_from_the_corners_than_allowed(
    drawn: list[tuple[float, float]], within_m: float
) -> None:
    points = np.array(drawn, np.float32)
    corners = drawn_corners(points, within_m=within_m)
    assert np.array_equal(corners[0], points[0])
    assert np.array_equal(corners[-1], points[-1])
    line = corners if len(corners) > 1 else np.repeat(corners, 2, axis=0)
    begin, along = line[:-1].astype(np.float64), np.diff(line.astype(np.float64), axis=0)
    share = np.einsum("tsk,sk->ts", points[:, None] - begin, along) / np.maximum((along**2).sum(-1), 1e-12)
    off = points[:, None] - begin - np.clip(share, 0, 1)[..., None] * along
    assert np.hypot(*np.moveaxis(off, -1, 0)).min(axis=1).max() <= within_m + 1e-5


def test_drawn_corners_are_at_most_as_many_as_a_path_may_have() -> None:
    zigzag = np.stack([np.arange(2000) * 0.2, np.arange(2000) % 2 * 0.5], axis=1)
    assert 2 <= len(drawn_corners(zigzag)) <= 256


@pytest.mark.parametrize("points", [np.zeros((0, 2)), [[0.0, math.nan]]])
def test_invalid_drawn_points_are_refused(points: np.ndarray) -> None:
    with pytest.raises(InvalidInput, match="points_m"):
        drawn_corners(points)
