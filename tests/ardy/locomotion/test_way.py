"""Walked paths: near their lines, within the limits of speed and acceleration, and the estimate of their duration."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_ardy.locomotion.way import ACCELERATION_M_S2, WayTooLong, paced, rounded, walked, walking_s

FPS = 20
STANDING = RootState(0.0, 0.0, 0.0, 0.0, 0.0)
coordinates = st.floats(-20, 20).map(lambda value: round(value, 2))
lines = st.lists(st.tuples(coordinates, coordinates), min_size=1, max_size=6, unique=True)


def distance_to(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(T) metres from points (T, 2) to the nearest of a line's segments."""
    begin, along = line[:-1], np.diff(line, axis=0)
    share = np.einsum("tsk,sk->ts", points[:, None] - begin, along) / np.maximum((along**2).sum(-1), 1e-12)
    nearest = begin + np.clip(share, 0, 1)[..., None] * along
    return np.hypot(*np.moveaxis(points[:, None] - nearest, -1, 0)).min(axis=1)


@settings(max_examples=60, deadline=None)
@given(corners=lines, smoothing=st.sampled_from([0.0, 0.05, 0.3, 2.0]), speed=st.sampled_from([0.5, 1.2, 4.0]))
def test_a_walked_path_keeps_to_its_lines_and_ends_at_the_last_corner(
    corners: list[tuple[float, float]], smoothing: float, speed: float
) -> None:
    line = np.array([(0.0, 0.0), *corners])
    ground = walked(np.array(corners), speed, smoothing, STANDING, FPS)
    assert np.allclose(ground[-1], line[-1], atol=1e-6)
    # A path of up to 140 m is sampled every 0.1 m at least, and may cut its corners by that.
    assert distance_to(line, ground).max() <= smoothing + 0.1
    steps = np.diff(np.concatenate([[[0.0, 0.0]], ground]), axis=0) * FPS
    assert np.hypot(*steps.T).max(initial=0.0) <= speed * 1.02 + 1e-6


@pytest.mark.parametrize("distance", [0.001, 0.03, 0.05])
def test_a_place_a_few_centimetres_away_is_reached(distance: float) -> None:
    ground = walked(np.array([[0.0, distance]]), 0.5, 0.0, STANDING, FPS)
    assert np.allclose(ground[-1], (0.0, distance), atol=1e-6)
    assert len(ground) <= FPS


def _paced_one_by_one(most: np.ndarray, steps: np.ndarray, first: float) -> np.ndarray:
    """The same paces, computed in another way: each from its neighbour, forwards and back."""
    pace = most.copy()
    pace[0], pace[-1] = first, 0.0
    gains = 2.0 * ACCELERATION_M_S2 * steps
    for index in range(1, len(pace)):
        pace[index] = min(pace[index], math.sqrt(pace[index - 1] ** 2 + gains[index - 1]))
    for index in range(len(pace) - 2, -1, -1):
        pace[index] = min(pace[index], math.sqrt(pace[index + 1] ** 2 + gains[index]))
    return pace


@settings(max_examples=60, deadline=None)
@given(
    most=st.lists(st.floats(0.0, 10.0), min_size=3, max_size=60),
    step=st.floats(0.01, 4.0),
    first=st.floats(0.0, 5.0),
)
def test_paces_respect_the_acceleration_limit(most: list[float], step: float, first: float) -> None:
    steps = np.full(len(most) - 1, step)
    expected = _paced_one_by_one(np.array(most), steps, first)
    assert paced(np.array(most), steps, first) == pytest.approx(expected, abs=1e-5)


def test_a_path_that_takes_too_long_is_refused_with_its_duration() -> None:
    slow = np.array([[0.0, 100.0]])
    assert len(walked(slow, 0.1, 0.0, STANDING, FPS, 1100.0)) > 1000 * FPS
    with pytest.raises(WayTooLong) as caught:
        walked(slow, 0.1, 0.0, STANDING, FPS, 900.0)
    assert caught.value.seconds == pytest.approx(1000.0, rel=0.01)


def test_a_path_too_long_only_by_its_bends_is_refused_before_its_frames_are_computed() -> None:
    bends = np.array([[(-1.0) ** number * 11.0, 0.1 * number] for number in range(256)])
    too_many_to_hold = 10**15
    with pytest.raises(WayTooLong):
        walked(bends, 10.0, 0.0, STANDING, too_many_to_hold, 600.0)


def test_a_corner_is_cut_by_the_allowed_distance() -> None:
    line = np.array([(0.0, 0.0), (0.0, 5.0), (5.0, 5.0)])
    way = rounded(line, 0.3)
    assert 0.2 < distance_to(line, way).max() <= 0.3
    assert np.hypot(*(way - line[1]).T).min() == pytest.approx(0.3, abs=0.01)


def test_a_path_starts_at_the_present_speed_and_ends_at_rest() -> None:
    going = RootState(0.0, 0.0, 0.0, 1.2, 0.0)
    along = np.diff(np.concatenate([[0.0], walked(np.array([[0.0, 6.0]]), 1.2, 0.3, going, FPS)[:, 1]])) * FPS
    assert along[0] == pytest.approx(1.2, abs=0.05)
    assert along[-1] < 0.25
    standing = walked(np.array([[0.0, 6.0]]), 1.2, 0.3, STANDING, FPS)
    speeds = np.diff(np.concatenate([[0.0], standing[:, 1]])) * FPS
    assert np.abs(np.diff(speeds)).max() <= 1.1 * ACCELERATION_M_S2 / FPS + 0.02


def test_a_character_that_faces_away_turns_before_it_walks() -> None:
    ground = walked(np.array([[0.0, -5.0]]), 1.2, 0.3, STANDING, FPS)
    assert np.allclose(ground[: FPS // 2], 0.0, atol=1e-6)
    assert len(ground) > len(walked(np.array([[0.0, 5.0]]), 1.2, 0.3, STANDING, FPS))


def test_a_path_to_the_present_place_takes_one_frame() -> None:
    assert len(walked(np.array([[0.0, 0.0]]), 1.2, 0.3, STANDING, FPS)) == 1


@pytest.mark.parametrize(
    ("place", "heading", "least", "most"),
    [
        ((0.0, 6.0), None, 5.0, 7.5),  # ahead
        ((0.0, -6.0), None, 6.0, 9.0),  # behind: turns first
        ((0.0, 6.0), math.pi, 6.5, 9.0),  # and turns round there
        ((0.0, 0.0), None, 0.6, 0.6),
        ((0.0, 0.0), math.pi / 2, 0.6, 1.5),
    ],
)
def test_estimated_walking_time_covers_the_path_and_the_turns(
    place: tuple[float, float], heading: float | None, least: float, most: float
) -> None:
    assert least <= walking_s(STANDING, place, heading) <= most


def test_a_running_character_arrives_sooner_than_a_standing_one() -> None:
    running = RootState(0.0, 0.0, 0.0, 3.0, 0.0)
    assert walking_s(running, (0.0, 9.0), None) < 0.6 * walking_s(STANDING, (0.0, 9.0), None)
