"""Ends of windows: a window ends earlier if that gives the next goal more room."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.model.sampling.options import SamplingOptions
from motiongen_ardy.model.sampling.window_end import frames_to_keep

FIRST, HORIZON = 100, 40
PLANNED = SamplingOptions(plan_root=True)
APPROACH = PLANNED.approach_frames


def waypoints(*after: int) -> Targets:
    """Places at frames counted from the window's first."""
    targets = Targets(load_skeleton("core27"))
    targets.add_waypoints([FIRST + frame for frame in after], torch.zeros(len(after), 2))
    return targets


def kept(targets: Targets | None, options: SamplingOptions = PLANNED) -> int:
    return frames_to_keep(targets, FIRST, HORIZON, options)


@pytest.mark.parametrize("goal", [0, 1, 20, HORIZON - 1, HORIZON + APPROACH, HORIZON + 60])
def test_a_goal_within_the_window_or_far_after_it_leaves_it_whole(goal: int) -> None:
    assert kept(waypoints(goal)) == HORIZON


@pytest.mark.parametrize("behind", [0, 1, 5, APPROACH - 1])
def test_a_goal_shortly_after_the_window_shortens_it(behind: int) -> None:
    assert kept(waypoints(HORIZON + behind)) == HORIZON + behind - APPROACH


def test_every_kind_of_goal_shortens_the_window() -> None:
    skeleton, frame = load_skeleton("core27"), FIRST + HORIZON
    turned, placed, lowered, posed = (Targets(skeleton) for _ in range(4))
    turned.add_heading([frame], torch.zeros(1))
    placed.add_rotations(frame, [5], torch.eye(3)[None])
    lowered.height[frame] = torch.tensor(0.8)
    posed.add_joints(frame, [0, 5], torch.zeros(2, 3))
    assert [kept(targets) for targets in (turned, placed, lowered, posed)] == [HORIZON - APPROACH] * 4


def test_dense_goals_leave_the_window_whole_and_do_not_hide_a_single_goal() -> None:
    path = waypoints(*range(80))
    assert kept(path) == HORIZON
    path.add_rotations(FIRST + HORIZON + 2, [5], torch.eye(3)[None])
    assert kept(path) == HORIZON + 2 - APPROACH


def test_among_several_goals_the_window_ends_farthest_before_the_next() -> None:
    assert kept(waypoints(30, 38, 46, 54)) == 39, "right after the one at 38"


@given(st.sets(st.integers(0, 80), min_size=1, max_size=6))
def test_no_other_end_would_leave_the_next_goal_more_room(goals: set[int]) -> None:
    def room(end: int) -> int:
        return min([goal - end for goal in goals if goal >= end] + [APPROACH])

    found = kept(waypoints(*sorted(goals)))
    assert HORIZON - APPROACH <= found <= HORIZON
    if any(HORIZON <= goal < HORIZON + APPROACH for goal in goals):
        assert room(found) == max(room(end) for end in range(HORIZON - APPROACH, HORIZON + 1))
    else:
        assert found == HORIZON


def test_planned_places_do_not_shorten_the_window() -> None:
    led = Targets(load_skeleton("core27"))
    led.add_lead(FIRST, torch.zeros(80, 2), torch.zeros(80), stride=5)
    assert kept(led) == HORIZON


def test_windows_of_models_without_plan_or_correction_stay_whole() -> None:
    goal = waypoints(HORIZON)
    assert kept(goal, SamplingOptions()) == HORIZON
    assert kept(goal, SamplingOptions(reach_joints=True)) < HORIZON
    assert kept(goal, replace(PLANNED, approach_frames=0)) == HORIZON
    assert kept(None) == HORIZON


def test_a_short_horizon_keeps_half_of_its_frames() -> None:
    targets = Targets(load_skeleton("core27"))
    targets.add_waypoints([FIRST + 8], torch.zeros(1, 2))
    assert frames_to_keep(targets, FIRST, 8, PLANNED) == 4
