"""Of constraints that contradict each other the heavier one holds, and of equal ones the later one."""

import numpy as np
import pytest

from motiongen_server.engine.session.precedence import in_force
from motiongen_server.engine.types import Constraint, HeadingTarget, JointTargets, RootTrajectory, Waypoint

WINDOW = range(0, 200)
MUST = Waypoint(1, 60, 0.0, 0.0)


def should(frame: int, x: float, weight: float = 0.5) -> Waypoint:
    return Waypoint(2, frame, x, 0.0, weight=weight)


def test_equal_ones_keep_the_order_in_which_they_were_set() -> None:
    held = (should(60, 9.0, 1.0), MUST)
    assert in_force(held, WINDOW, 20) == held


def test_the_heavier_is_laid_on_last() -> None:
    light, heavy = should(60, 0.0), Waypoint(3, 60, 1.0, 0.0, weight=2.0)
    assert in_force((heavy, MUST, light), WINDOW, 20) == (light, MUST, heavy)


@pytest.mark.parametrize(("frame", "x", "is_kept"), [(80, 3.9, True), (80, 4.3, False), (40, -4.3, False)])
def test_one_that_nobody_could_come_to_from_a_heavier_one_is_left_out(frame: int, x: float, is_kept: bool) -> None:
    light = should(frame, x)
    assert (light in in_force((MUST, light), WINDOW, 20)) is is_kept


def test_a_heavier_one_is_never_left_out_for_a_lighter_one() -> None:
    heavy = should(80, 50.0, weight=5.0)
    assert in_force((MUST, heavy), WINDOW, 20) == (heavy,)


def test_what_asks_for_no_place_contradicts_none() -> None:
    others: tuple[Constraint, ...] = (
        HeadingTarget(2, 61, 1.0, weight=0.1),
        JointTargets(3, 61, (4,), np.full((1, 3), 99, np.float32), weight=0.1),
    )
    assert set(in_force((MUST, *others), WINDOW, 20)) == {MUST, *others}


def test_of_a_path_the_frames_of_the_window_count() -> None:
    path = RootTrajectory(2, 0, np.column_stack([np.arange(400) * 0.05, np.zeros(400)]).astype(np.float32), weight=0.5)
    there = Waypoint(1, 380, 40.0, 0.0)
    assert path in in_force((there, path), range(0, 200), 20)
    assert path not in in_force((there, path), range(200, 400), 20)
