"""Planned roots: goals within reach are met at a person's speed, others missed, and dense paths left alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from motiongen_ardy.model.sampling.options import PlanOptions
from motiongen_ardy.model.sampling.root_plan import PlanSpan, RootGoals, plan_root, runs, without_steering
from motiongen_ardy.model.sampling.steering import RootState, steer, turned_on_the_spot

FPS, FIRST = 20, 16
OPTIONS = PlanOptions()
SPAN = PlanSpan(FIRST, FIRST + 400, FIRST + 400, FPS)


def state(speed: float = 0.0, heading: float = 0.0) -> RootState:
    """A root at the origin that moves in the direction that it faces."""
    return RootState(np.zeros(2), speed * np.array([math.sin(heading), math.cos(heading)]), heading)


def walked(plan: RootGoals) -> np.ndarray:
    """Speeds in m/s between the places of a plan, from the origin on."""
    frames = sorted(plan.ground)
    places = np.concatenate([np.zeros((1, 2)), np.stack([plan.ground[frame] for frame in frames])])
    gaps = np.diff(np.array([FIRST - 1, *frames])) / FPS
    return np.hypot(*np.diff(places, axis=0).T) / gaps


@settings(max_examples=60, deadline=None)
@given(st.floats(1.5, 6.0), st.floats(-math.pi, math.pi), st.floats(0.2, 1.0), st.sampled_from([0.0, 1.2]))
def test_a_goal_within_reach_is_reached_at_a_persons_speed(
    seconds: float, angle: float, share: float, speed: float
) -> None:
    reach = max(0.0, 1.2 * (seconds - abs(angle) / math.pi))
    frame = FIRST - 1 + int(seconds * FPS)
    goal = share * reach * np.array([math.sin(angle), math.cos(angle)])
    plan = plan_root(RootGoals({frame: goal}), state(speed), SPAN, OPTIONS)
    assert plan.ground[frame] == pytest.approx(goal, abs=1e-6)
    assert walked(plan).max() < 2.6
    assert frame not in plan.planned
    assert plan.planned == set(plan.ground) - {frame}


def test_a_goal_out_of_reach_is_missed_at_a_bounded_speed() -> None:
    plan = plan_root(RootGoals({FIRST + 39: np.array([0.0, 30.0])}), state(), SPAN, OPTIONS)
    assert 2.0 < plan.ground[FIRST + 39][1] < 5.0
    assert walked(plan).max() < 2.6


@pytest.mark.parametrize("speed", [0.0, 1.2, 2.5])
@pytest.mark.parametrize("ahead", [11, 20, 40])
def test_a_path_that_begins_later_is_approached_at_a_bounded_speed(speed: float, ahead: int) -> None:
    places = {FIRST + ahead + 10 * index: np.array([0.4 * index, 2.0 + 0.6 * index]) for index in range(4)}
    plan = plan_root(RootGoals(places), state(speed), SPAN, OPTIONS)
    assert set(places) <= plan.ground.keys()
    assert plan.planned.isdisjoint(places)
    assert walked(plan).max() < 4.5
    assert plan.ground[max(places)] == pytest.approx(places[max(places)], abs=0.25)


def test_a_far_goal_is_approached_from_the_start() -> None:
    plan = plan_root(RootGoals({FIRST + 119: np.array([0.0, 6.0])}), state(), SPAN, OPTIONS)
    assert plan.ground[FIRST + 39][1] > 1.2


def test_the_body_turns_to_a_goal_behind_it_before_it_walks() -> None:
    path = steer(state(), np.array([0.0, -3.0]), None, 80, FPS, OPTIONS)
    speed = np.diff(path.ground, axis=0) * FPS
    facing = np.stack([np.sin(path.heading[1:]), np.cos(path.heading[1:])], axis=1)
    assert (np.sum(speed * facing, axis=1) > -0.1).all()
    assert abs(math.remainder(path.heading[-1] - math.pi, math.tau)) < 0.1


def test_the_heading_of_a_waypoint_is_turned_to_at_the_end_of_the_walk() -> None:
    frame = FIRST + 59
    asked = RootGoals({frame: np.array([0.0, 3.0])}, {frame: math.pi / 2})
    plan = plan_root(asked, state(1.0), SPAN, OPTIONS)
    assert plan.heading[frame] == pytest.approx(math.pi / 2, abs=0.02)
    assert abs(plan.heading[min(plan.faced)]) < 0.2
    assert frame not in plan.faced


@pytest.mark.parametrize("degrees", [90, 180, -135])
def test_a_turn_on_the_spot_is_planned_with_headings_only(degrees: int) -> None:
    frame, asked = FIRST + 39, math.radians(degrees)
    plan = plan_root(RootGoals(heading={frame: asked}), state(), SPAN, OPTIONS)
    assert not plan.ground
    assert math.remainder(plan.heading[frame] - asked, math.tau) == pytest.approx(0.0, abs=1e-6)
    turned = np.unwrap([0.0, *(plan.heading[one] for one in sorted(plan.heading))])
    assert np.abs(np.diff(turned)).max() < OPTIONS.turn_rate_rad_s * OPTIONS.stride_frames / FPS


def test_a_path_that_continues_from_the_root_is_unchanged() -> None:
    places = {FIRST + index: np.array([0.0, 0.05 * (index + 1)]) for index in range(40)}
    plan = plan_root(RootGoals(dict(places)), state(1.0), SPAN, OPTIONS)
    assert all(plan.ground[frame] == pytest.approx(place, abs=1e-9) for frame, place in places.items())
    assert plan.faced
    assert max(abs(plan.heading[frame]) for frame in plan.faced) < 1e-6


def test_a_path_that_begins_elsewhere_is_joined_without_a_jump() -> None:
    places = {FIRST + index: np.array([1.0, 0.05 * (index + 1)]) for index in range(80)}
    plan = plan_root(RootGoals(dict(places)), state(1.0), SPAN, OPTIONS)
    assert walked(plan).max() < 3.0
    assert plan.ground[FIRST + 79] == pytest.approx(places[FIRST + 79], abs=1e-6)


def test_a_corner_is_rounded_within_8_cm() -> None:
    along = np.arange(1, 81) / FPS
    corner = np.stack([np.maximum(along - 2.0, 0.0), np.minimum(along, 2.0)], axis=1)
    plan = plan_root(RootGoals({FIRST + i: place for i, place in enumerate(corner)}), state(1.0), SPAN, OPTIONS)
    given_way = np.stack([plan.ground[FIRST + index] for index in range(80)])
    assert np.hypot(*(given_way - corner).T).max() < 0.08
    bend = np.hypot(*(given_way[2:] - 2 * given_way[1:-1] + given_way[:-2]).T) * FPS**2
    assert bend.max() < 6.0


def test_a_character_that_walks_backwards_keeps_its_heading_on_a_path() -> None:
    places = {FIRST + index: np.array([0.0, -0.05 * (index + 1)]) for index in range(40)}
    backwards = RootState(np.zeros(2), np.array([0.0, -1.0]), 0.0)
    plan = plan_root(RootGoals(dict(places)), backwards, SPAN, OPTIONS)
    assert max(abs(plan.heading[frame]) for frame in plan.faced) < 0.01


def test_past_goals_and_goals_beyond_the_span_are_unchanged() -> None:
    asked = RootGoals({3: np.array([9.0, 9.0]), FIRST + 900: np.array([1.0, 1.0])})
    plan = plan_root(asked, state(), SPAN, OPTIONS)
    assert {frame: tuple(place) for frame, place in plan.ground.items()} == {3: (9.0, 9.0), FIRST + 900: (1.0, 1.0)}


def test_requested_places_remove_planned_ones_before_them() -> None:
    leads = {FIRST + index: np.array([5.0, 5.0]) for index in range(0, 40, 5)}
    asked = RootGoals({**leads, FIRST + 12: np.zeros(2)}, planned=set(leads))
    assert set(without_steering(asked, FIRST).ground) == {f for f in leads if f > FIRST + 12} | {FIRST + 12}


def test_planned_places_needed_by_joint_targets_are_kept() -> None:
    leads = {FIRST + index: np.array([5.0, 5.0]) for index in range(0, 40, 5)}
    turns = dict.fromkeys(leads, 0.5)
    asked = RootGoals({**leads, FIRST + 42: np.zeros(2)}, turns, planned=set(leads), faced=set(leads) - {FIRST + 10})
    kept = without_steering(asked, FIRST, {FIRST + 20})
    assert set(kept.ground) == {FIRST + 20, FIRST + 42}
    assert kept.planned == {FIRST + 20}
    assert set(kept.heading) == {FIRST + 10}, "a heading that a client asked for is kept"


def test_runs_group_three_goals_close_together() -> None:
    assert list(runs([1, 5, 9, 40, 45, 80])) == [[1, 5, 9], [40], [45], [80]]


def test_a_turn_on_the_spot_respects_the_turn_rates() -> None:
    for degrees, count in ((90, 50), (180, 80), (180, 20)):
        turned = turned_on_the_spot(0.0, math.radians(degrees), count, FPS, OPTIONS)
        rates = np.diff(turned, prepend=0.0) * FPS
        assert rates.min() >= 0.0
        assert rates.max() < OPTIONS.turn_rate_rad_s + 1e-6
        if count > 20:
            assert turned[-1] == pytest.approx(math.radians(degrees))
            assert rates.max() < 1.6 * OPTIONS.spot_turn_rad_s
