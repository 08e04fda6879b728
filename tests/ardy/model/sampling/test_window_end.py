"""Ends of windows: a goal never follows closely on one where an earlier end gives it room."""

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
def test_a_goal_within_a_window_or_far_behind_it_leaves_it_whole(goal: int) -> None:
    assert kept(waypoints(goal)) == HORIZON


@pytest.mark.parametrize("behind", [0, 1, 5, APPROACH - 1])
def test_a_goal_close_behind_a_window_gets_its_room_from_it(behind: int) -> None:
    assert kept(waypoints(HORIZON + behind)) == HORIZON + behind - APPROACH


def test_every_kind_of_goal_gets_room() -> None:
    skeleton, frame = load_skeleton("core27"), FIRST + HORIZON
    turned, placed, lowered, posed = (Targets(skeleton) for _ in range(4))
    turned.add_heading([frame], torch.zeros(1))
    placed.add_rotations(frame, [5], torch.eye(3)[None])
    lowered.height[frame] = torch.tensor(0.8)
    posed.add_joints(frame, [0, 5], torch.zeros(2, 3))
    assert [kept(targets) for targets in (turned, placed, lowered, posed)] == [HORIZON - APPROACH] * 4


def test_goals_at_every_frame_leave_a_window_whole_and_do_not_hide_a_lone_one() -> None:
    path = waypoints(*range(80))
    assert kept(path) == HORIZON
    path.add_rotations(FIRST + HORIZON + 2, [5], torch.eye(3)[None])
    assert kept(path) == HORIZON + 2 - APPROACH


def test_of_goals_in_a_row_the_window_ends_where_the_next_is_farthest() -> None:
    assert kept(waypoints(30, 38, 46, 54)) == 39, "right after the one at 38"


@given(st.sets(st.integers(0, 80), min_size=1, max_size=6))
def test_no_end_in_question_would_leave_the_next_goal_more_room(goals: set[int]) -> None:
    def room(end: int) -> int:
        return min([goal - end for goal in goals if goal >= end] + [APPROACH])

    found = kept(waypoints(*sorted(goals)))
    assert HORIZON - APPROACH <= found <= HORIZON
    if any(HORIZON <= goal < HORIZON + APPROACH for goal in goals):
        assert room(found) == max(room(end) for end in range(HORIZON - APPROACH, HORIZON + 1))
    else:
        assert found == HORIZON


def test_what_only_leads_to_goals_needs_no_room() -> None:
    led = Targets(load_skeleton("core27"))
    led.add_lead(FIRST, torch.zeros(80, 2), torch.zeros(80), stride=5)
    assert kept(led) == HORIZON


def test_models_that_are_neither_planned_nor_corrected_keep_their_windows() -> None:
    goal = waypoints(HORIZON)
    assert kept(goal, SamplingOptions()) == HORIZON
    assert kept(goal, SamplingOptions(reach_joints=True)) < HORIZON
    assert kept(goal, replace(PLANNED, approach_frames=0)) == HORIZON
    assert kept(None) == HORIZON


def test_a_short_horizon_keeps_half_of_itself() -> None:
    targets = Targets(load_skeleton("core27"))
    targets.add_waypoints([FIRST + 8], torch.zeros(1, 2))
    assert frames_to_keep(targets, FIRST, 8, PLANNED) == 4
