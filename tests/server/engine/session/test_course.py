"""A lead gives way to the places at which the root is asked to be, and continues after them."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_ardy.locomotion.velocity import RootState
from motiongen_server.engine.session.course import Course, behind_places
from motiongen_server.engine.types import VELOCITY_ID, Constraint, HeadingTarget, RootTrajectory, Waypoint
from tests.server.engine.session.playing import playing

WINDOW = range(100, 284)


def lead(first: int = 100, num_frames: int = 40) -> RootTrajectory:
    """A lead along +X, 0.1 m a frame."""
    xz = np.zeros((num_frames, 2), np.float32)
    xz[:, 0] = 0.1 * np.arange(num_frames)
    return RootTrajectory(VELOCITY_ID, first, xz, np.full(num_frames, 1.5, np.float32))


def test_lead_without_places_in_the_window_is_unchanged() -> None:
    path = lead()
    assert behind_places(path, [HeadingTarget(1, 120, 0.5)], WINDOW) is path
    assert behind_places(path, [Waypoint(1, 300, 5.0, 5.0)], WINDOW) is path, "it is led to, from beyond the window"
    assert behind_places(None, [Waypoint(1, 120, 5.0, 5.0)], WINDOW) is None


def test_lead_continues_from_the_last_place() -> None:
    places: list[Constraint] = [Waypoint(1, 119, 7.0, 2.0), Waypoint(2, 109, 1.0, 1.0)]
    left = behind_places(lead(), places, WINDOW)
    assert left is not None
    assert left.first_frame == 120
    assert left.last_frame == 139
    np.testing.assert_allclose(left.xz[0], [7.1, 2.0], atol=1e-5)
    np.testing.assert_allclose(left.xz[-1], [9.0, 2.0], atol=1e-5)
    assert left.heading is not None
    assert len(left.heading) == 20


def test_lead_is_dropped_if_a_place_lies_beyond_its_end() -> None:
    assert behind_places(lead(), [Waypoint(1, 283, 5.0, 5.0)], WINDOW) is None
    path = RootTrajectory(1, 130, np.zeros((200, 2), np.float32))
    assert behind_places(lead(), [path], WINDOW) is None


def test_velocity_gives_way_to_a_waypoint_until_it_is_reached() -> None:
    stage, viewer = playing()
    stage.set_velocity(viewer, 3.0, 0.0, hold_frames=400)
    stage.run(1.0)
    frame = viewer.buffered_to + 120
    seq = stage.set_constraints(viewer, Waypoint(5, frame, -4.0, 0.0))
    stage.run(3.0)
    effective = viewer.outcomes[seq].effective_frame
    assert effective is not None
    answering = [job for job in stage.runner.prepared if effective <= job.first_frame <= frame - 40]
    assert len(answering) >= 2, "more than one window on the way there"
    for job in answering:
        assert [each.constraint_id for each in job.constraints] == [5]
        assert job.keep_prompt is False


WALKING = RootState(x=0.0, z=0.0, speed_x=1.0, speed_z=0.0, heading=0.0)
"""At the origin, a metre a second along +X."""


def course(*constraints: Constraint, path: RootTrajectory | None = None) -> Course:
    """The course in a window of the frames from 100 to 283, at 20 frames a second."""
    return Course(WINDOW, 20, WALKING, path, constraints)


def places(going: Course, *frames: int) -> list[tuple[float, float]]:
    """The places at these frames, to a tenth of a millimetre."""
    return [(round(x, 4), round(z, 4)) for x, z in map(going.at, frames)]


def test_course_without_places_goes_straight_for_a_second_and_then_stops() -> None:
    going = course(HeadingTarget(1, 120, 0.5))
    assert places(going, 99, 100, 119, 120, 200) == [(0.0, 0.0), (0.05, 0.0), (1.0, 0.0), (1.0, 0.0), (1.0, 0.0)]
    assert not going.is_led_at(100)


def test_course_is_straight_between_places_and_stops_at_the_last() -> None:
    going = course(Waypoint(1, 109, 1.0, 2.0), Waypoint(2, 119, 3.0, 2.0), Waypoint(3, 284, 9.0, 9.0))
    there = [(0.5, 1.0), (1.0, 2.0), (2.0, 2.0), (3.0, 2.0), (3.0, 2.0)]
    assert places(going, 104, 109, 114, 119, 283) == there
    going.add(129, 3.0, 4.0)
    assert places(going, 124, 129, 283) == [(3.0, 3.0), (3.0, 4.0), (3.0, 4.0)]
    going.add(129, 3.0, 6.0)
    assert places(going, 124) == [(3.0, 4.0)]


@pytest.mark.parametrize("first", [60, 100, 110, 250])
def test_course_follows_a_root_trajectory_within_the_window(first: int) -> None:
    path = RootTrajectory(1, first, np.column_stack([np.arange(80), np.full(80, 5)]).astype(np.float32))
    going = course(path)
    for frame in range(max(first, 100), min(first + 80, 284)):
        assert going.at(frame) == (frame - first, 5.0)
    behind = min(first + 80, 284) - 1
    assert going.at(behind + 30) == (behind - first, 5.0), "it stands there"
    assert not going.is_led_at(behind)
    assert course(path, path=lead(100, 10)).is_led_at(109)


def test_course_continues_for_a_second_after_a_lead() -> None:
    going = course(path=lead(100, 40))
    assert [going.is_led_at(frame) for frame in (100, 139, 140)] == [True, True, False]
    assert [going.at(frame)[0] for frame in (100, 139, 140, 159, 160)] == pytest.approx([0.0, 3.9, 4.0, 5.9, 5.9])
    given = course(Waypoint(1, 150, 0.0, 0.0), path=lead(100, 40))
    assert given.at(170) == (0.0, 0.0), "it stays at a place that it was asked to be at"
