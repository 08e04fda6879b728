"""A lead goes on behind the places that the root is asked to be at, and gives way to them before."""

from __future__ import annotations

import numpy as np

from motiongen_server.engine.session.course import behind_places
from motiongen_server.engine.types import VELOCITY_ID, Constraint, HeadingTarget, RootTrajectory, Waypoint
from tests.server.engine.session.playing import playing

WINDOW = range(100, 284)


def lead(first: int = 100, num_frames: int = 40) -> RootTrajectory:
    """Along +X, 0.1 m a frame."""
    xz = np.zeros((num_frames, 2), np.float32)
    xz[:, 0] = 0.1 * np.arange(num_frames)
    return RootTrajectory(VELOCITY_ID, first, xz, np.full(num_frames, 1.5, np.float32))


def test_without_places_a_lead_stays_as_it_is() -> None:
    path = lead()
    assert behind_places(path, [HeadingTarget(1, 120, 0.5)], WINDOW) is path
    assert behind_places(path, [Waypoint(1, 300, 5.0, 5.0)], WINDOW) is path, "it is led to, from beyond the window"
    assert behind_places(None, [Waypoint(1, 120, 5.0, 5.0)], WINDOW) is None


def test_it_goes_on_from_the_last_place() -> None:
    places: list[Constraint] = [Waypoint(1, 119, 7.0, 2.0), Waypoint(2, 109, 1.0, 1.0)]
    left = behind_places(lead(), places, WINDOW)
    assert left is not None
    assert left.first_frame == 120
    assert left.last_frame == 139
    np.testing.assert_allclose(left.xz[0], [7.1, 2.0], atol=1e-5)
    np.testing.assert_allclose(left.xz[-1], [9.0, 2.0], atol=1e-5)
    assert left.heading is not None
    assert len(left.heading) == 20


def test_nothing_is_left_of_it_where_a_place_lies_farther_ahead_than_it_leads() -> None:
    assert behind_places(lead(), [Waypoint(1, 283, 5.0, 5.0)], WINDOW) is None
    path = RootTrajectory(1, 130, np.zeros((200, 2), np.float32))
    assert behind_places(lead(), [path], WINDOW) is None


def test_a_velocity_that_is_held_gives_way_to_a_place_until_it_is_reached() -> None:
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
