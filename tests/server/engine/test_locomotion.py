"""Gaits: which one a velocity selects, when it ends, and which prompt the windows of a session get."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_ardy.locomotion.gait import quarter_of
from motiongen_ardy.locomotion.velocity import SLOWING_FRAMES
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.locomotion import gait_of
from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.edits import edited
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.prompt_edits import edit_prompts
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import Direction, Gait, SessionKey, SetPrompts, SetVelocity
from tests.server.engine.stage import Stage, prompt

KEY = SessionKey(1, 1)
OWN = 9


def _gait(marker: int, name: str, from_mps: float, direction: Direction = Direction.FORWARD) -> Gait:
    return Gait(name, name, from_mps, direction, np.array([marker, 0], np.float32))


STAND, WALK, RUN = _gait(1, "stand", 0.0), _gait(2, "walk", 0.15), _gait(3, "run", 2.0)
BACK = _gait(4, "back", 0.15, Direction.BACKWARD)
LEFT = _gait(5, "left", 0.15, Direction.LEFT)
GAITS = (STAND, WALK, RUN, BACK, LEFT)


def _unasked() -> Anchor:
    raise AssertionError("a velocity does not ask where the character is")


def _event(
    x: float, z: float, heading: float | None = None, hold_frames: int = 40, keep_prompt: bool = False
) -> SetVelocity:
    return SetVelocity(KEY, 1, 0.0, x, z, heading, hold_frames, keep_prompt)


@pytest.mark.parametrize(
    ("speed", "expected"), [(0.0, STAND), (0.14, STAND), (0.16, WALK), (1.9, WALK), (2.0, RUN), (4.0, RUN)]
)
def test_gait_is_chosen_by_speed(speed: float, expected: Gait) -> None:
    assert gait_of(GAITS, _event(0.6 * speed, -0.8 * speed), None) is expected


@pytest.mark.parametrize(
    ("x", "z", "heading", "expected"),
    [
        (0.0, 1.0, 0.0, WALK),
        (0.0, -1.0, 0.0, BACK),
        (1.0, 0.0, 0.0, LEFT),
        (-1.0, 0.0, 0.0, WALK),  # no gait goes to the right
        (-1.0, 0.0, -math.pi / 2, WALK),
        (1.0, 0.0, -math.pi / 2, BACK),
        (0.0, -1.0, math.pi / 2 + math.tau, LEFT),  # facing +X, with -Z to its left
        (0.0, -0.05, 0.0, STAND),
        (0.0, -3.0, 0.0, BACK),
        (0.0, -1.0, None, WALK),
    ],
)
def test_gait_direction_is_relative_to_the_heading(x: float, z: float, heading: float | None, expected: Gait) -> None:
    assert gait_of(GAITS, _event(x, z, heading), None) is expected


@given(st.floats(-100, 100))
def test_quarter_of_an_angle_is_the_nearest_direction(angle: float) -> None:
    centre = quarter_of(angle) * math.pi / 2
    assert abs(math.remainder(angle - centre, math.tau)) <= math.pi / 4 + 1e-9


def test_gait_does_not_flicker_at_the_border_between_two_speeds() -> None:
    speeds = [1.0, 1.95, 2.05, 1.95, 2.1, 1.9, 2.3, 2.1, 1.9, 2.05, 1.85, 1.7, 2.0]
    held, gaits = None, []
    for speed in speeds:
        held = gait_of(GAITS, _event(0.0, speed), held)
        gaits.append(held)
    assert gaits == [WALK] * 6 + [RUN] * 4 + [RUN] + [WALK] * 2


def test_no_gait_is_chosen_with_keep_prompt_or_without_gaits() -> None:
    assert gait_of(GAITS, _event(0.0, 1.0, keep_prompt=True), WALK) is None
    assert gait_of((), _event(0.0, 1.0), None) is None


# ---- conditions -----------------------------------------------------------------------------------------------------

HELD = Conditions((prompt(OWN),), (), Velocity(0.0, 1.0, None, 50, steers_from=100), WALK)


def test_gait_applies_while_the_velocity_steers_then_own_prompt_returns() -> None:
    assert [_marker(HELD, frame) for frame in (100, 149, 150)] == [2, 2, OWN]
    assert HELD.prompt_change_after(100, 180) == 150
    assert HELD.prompt_change_after(100, 140) == 140
    assert HELD.prompt_change_after(140, 180) == 160  # half a window at least
    assert replace(HELD, gait=None).prompt_change_after(100, 180) == 180


def test_velocity_not_yet_in_force_is_taken_to_begin_at_the_window() -> None:
    waiting = replace(HELD, velocity=Velocity(0.0, 1.0, None, 50))
    assert waiting.prompt_change_after(300, 400) == 350
    assert waiting.with_velocity_landed(waiting.velocity, 300).prompt_change_after(300, 400) == 350


def test_own_prompt_equal_to_the_gait_is_no_prompt_change() -> None:
    assert replace(HELD, prompts=(prompt(2),)).prompt_change_after(100, 180) == 180


def test_prompt_set_during_a_velocity_changes_frames_from_its_end_on() -> None:
    _, changed_from = edit_prompts(HELD, SetPrompts(KEY, 1, 0.0, (prompt(7),)), 120, 8)
    assert changed_from == 150


@pytest.mark.parametrize(
    ("event", "changed_from", "marker"),
    [
        (_event(0.0, 1.0), 150, 2),  # the same velocity again: 40 more frames from 120 on
        (_event(0.0, 1.0, keep_prompt=True), 120, OWN),
        (_event(0.0, 3.0), 120, 3),
        (_event(0.0, 0.0), 120, 1),
    ],
)
def test_velocity_edit_changes_frames_from_where_path_or_prompt_differs(
    event: SetVelocity, changed_from: int, marker: int
) -> None:
    after, kind, found, *_ = edited(
        HELD, event, floor=120, reach=200, config=EngineConfig(), anchor=_unasked, gaits=GAITS
    )
    assert (kind, found) == ("velocity", changed_from)
    assert _marker(after, 130) == marker


def test_past_velocity_and_its_gait_are_dropped_after_the_slowing_down() -> None:
    slowed = 150 + SLOWING_FRAMES  # until then the root slows down, under the session's own prompt
    assert HELD.without_past(slowed - 1).gait is WALK
    assert _marker(HELD, slowed - 1) == OWN
    past = HELD.without_past(slowed)
    assert (past.velocity, past.gait) == (None, None)


def _marker(conditions: Conditions, frame: int) -> int:
    held = conditions.prompt_at(frame)
    assert held is not None
    return int(held.embedding[0])


# ---- a session ------------------------------------------------------------------------------------------------------


def _prompts_of_windows(keep_prompt: bool) -> list[tuple[int, int]]:
    """First frame and prompt of every window of a session that is steered for 60 frames, from 2 s on."""
    stage = Stage()
    viewer = stage.open(prompts=(prompt(OWN),), gaits=GAITS)
    stage.run(2.0)
    stage.set_velocity(viewer, 0.0, 1.0, hold_frames=60, keep_prompt=keep_prompt)
    stage.run(8.0)
    stage.check_finished()
    return [(job.first_frame, int(job.embedding[0])) for job in stage.runner.prepared if job.embedding is not None]


def test_windows_get_the_gait_while_the_velocity_steers() -> None:
    windows = _prompts_of_windows(keep_prompt=False)
    steered = [frame for frame, marker in windows if marker == 2]
    assert steered
    begin = steered[0]
    assert all(marker == (2 if begin <= frame < begin + 60 else OWN) for frame, marker in windows)
    assert begin + 60 in [frame for frame, _ in windows]


def test_windows_get_the_own_prompt_with_keep_prompt() -> None:
    assert {marker for _, marker in _prompts_of_windows(keep_prompt=True)} == {OWN}
