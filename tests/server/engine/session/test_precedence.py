"""Of constraints that contradict each other, the heavier one wins, and of equal ones the later one."""

import numpy as np
import pytest

from motiongen_server.engine.session import precedence
from motiongen_server.engine.session.kinematics import Float64
from motiongen_server.engine.session.precedence import in_force
from motiongen_server.engine.types import Constraint, HeadingTarget, JointTargets, RootTrajectory, Waypoint

WINDOW = range(0, 200)
MUST = Waypoint(1, 60, 0.0, 0.0)


def should(frame: int, x: float, weight: float = 0.5) -> Waypoint:
    return Waypoint(2, frame, x, 0.0, weight=weight)


def test_constraints_of_equal_weight_keep_the_order_in_which_they_were_set() -> None:
    held = (should(60, 9.0, 1.0), MUST)
    assert in_force(held, WINDOW, 20) == held


def test_heavier_constraints_are_applied_last() -> None:
    light, heavy = should(60, 0.0), Waypoint(3, 60, 1.0, 0.0, weight=2.0)
    assert in_force((heavy, MUST, light), WINDOW, 20) == (light, MUST, heavy)


@pytest.mark.parametrize(("frame", "x", "is_kept"), [(80, 3.9, True), (80, 4.3, False), (40, -4.3, False)])
def test_waypoint_out_of_reach_from_a_heavier_one_is_left_out(frame: int, x: float, is_kept: bool) -> None:
    light = should(frame, x)
    assert (light in in_force((MUST, light), WINDOW, 20)) is is_kept


def test_heavier_waypoint_is_never_left_out_for_a_lighter_one() -> None:
    heavy = should(80, 50.0, weight=5.0)
    assert in_force((MUST, heavy), WINDOW, 20) == (heavy,)


def test_constraints_without_a_root_position_contradict_none() -> None:
    others: tuple[Constraint, ...] = (
        HeadingTarget(2, 61, 1.0, weight=0.1),
        JointTargets(3, 61, (4,), np.full((1, 3), 99, np.float32), weight=0.1),
    )
    assert set(in_force((MUST, *others), WINDOW, 20)) == {MUST, *others}


def test_only_the_frames_of_a_path_in_the_window_count() -> None:
    path = RootTrajectory(2, 0, np.column_stack([np.arange(400) * 0.05, np.zeros(400)]).astype(np.float32), weight=0.5)
    there = Waypoint(1, 380, 40.0, 0.0)
    assert path in in_force((there, path), range(0, 200), 20)
    assert path not in in_force((there, path), range(200, 400), 20)


@pytest.mark.parametrize(("frames", "num_weights"), [(1, 256), (1, 2), (93, 256), (93, 2), (400, 60), (400, 2)])
def test_frames_are_compared_once_for_each_weight_and_only_those_of_the_window(
    monkeypatch: pytest.MonkeyPatch, frames: int, num_weights: int
) -> None:
    """A client may ask for hundreds, each of its own weight, and each of their windows delays all other sessions."""
    compared: list[int] = []

    class Counted(precedence._HeavierPlaces):
        def _least_along(self) -> Float64:
            compared.append(len(self._frames))
            return super()._least_along()

    monkeypatch.setattr(precedence, "_HeavierPlaces", Counted)
    places = np.zeros((frames, 2), np.float32)
    weights = [1.0 + number * num_weights // 256 for number in range(256)]
    held = [
        Waypoint(number + 1, number % 200, 0.0, 0.0, weight=weight)
        if frames == 1
        else RootTrajectory(number + 1, number % 108, places, weight=weight)
        for number, weight in enumerate(weights)
    ]
    assert in_force(held, WINDOW, 20) == tuple(held)
    assert compared == [len(WINDOW)] * num_weights


@pytest.mark.parametrize("seed", range(40))
def test_in_force_agrees_with_a_comparison_of_every_pair(seed: int) -> None:
    numbers = np.random.default_rng(seed)
    held = [
        Waypoint(number, int(frame), float(x), float(z), weight=float(weight))
        for number, (frame, x, z, weight) in enumerate(
            zip(
                numbers.integers(0, 200, 8),
                *numbers.uniform(-12, 12, (2, 8)),
                numbers.choice((0.5, 1.0, 2.0), 8),
                strict=True,
            )
        )
    ]
    kept: list[Waypoint] = []
    for item in sorted(held, key=lambda each: (each.weight, each.constraint_id), reverse=True):
        heavier = [other for other in kept if other.weight > item.weight and other.frame != item.frame]
        if all(_apart(item, other) <= 0.2 * abs(item.frame - other.frame) + 0.05 for other in heavier):
            kept.append(item)
    assert in_force(held, WINDOW, 20) == tuple(kept[::-1])


def _apart(one: Waypoint, other: Waypoint) -> float:
    return float(np.hypot(one.x - other.x, one.z - other.z))


@pytest.mark.parametrize("first", [-30, 0, 7, 150, 199])
def test_place_of_a_path_is_that_of_its_own_frame_wherever_it_begins(first: int) -> None:
    """It goes 5 cm a frame, from x = 1 at its first frame; each of its frames in the window has a place of its own."""
    xz = np.column_stack([1.0 + np.arange(60) * 0.05, np.zeros(60)]).astype(np.float32)
    path = RootTrajectory(2, first, xz, weight=0.5)
    inside = [frame for frame in (first, first + 30, first + 59) if frame in WINDOW]
    for frame in inside:
        x = 1.0 + (frame - first) * 0.05
        for away, is_kept in ((0.0, True), (0.2, True), (0.4, False)):
            there = Waypoint(1, frame + 1, x + away, 0.0)
            assert (path in in_force((there, path), WINDOW, 20)) is is_kept
    assert inside
