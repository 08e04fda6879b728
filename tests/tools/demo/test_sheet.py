"""Drawings, checked by the words and marks on them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from motiongen_client import InvalidInput, JointTargets, Motion, RootTrajectory, Waypoint
from motiongen_tools.demo.goals import Facing, Goal, Pace
from motiongen_tools.demo.ground import draw_ground
from motiongen_tools.demo.sheet import Scene, write_scenes, write_story
from motiongen_tools.demo.strip import draw_strip

GOALS = (
    Goal("2 m ahead", 0, Waypoint(20, 1.0, 1.1)),
    Goal("a hand", 0, JointTargets(30, (0, 6), np.ones((2, 3)))),
    Goal("a path", 0, RootTrajectory(0, np.ones((30, 2)))),
    Goal("face left", 0, Facing(20, 1.0)),
    Goal("walk", 0, Pace(0, 20, 0.0, 1.0)),
    Goal("much later", 0, Waypoint(400, 1.0, 20.0)),
)


def test_the_view_from_above_shows_the_distance_from_a_waypoint(stick_motion: Motion) -> None:
    axes = Figure().add_subplot()
    draw_ground(axes, stick_motion, GOALS)
    words = [text.get_text() for text in axes.texts]
    assert "10 cm at 1 s" in words
    assert not any("20 s" in word for word in words)  # not due
    stars = [line for line in axes.lines if line.get_marker() == "*"]
    assert len(stars) == 3


def test_the_strip_shows_times_prompts_goals_and_contacts(stick_motion: Motion) -> None:
    rows = stick_motion.rows.copy()
    rows[:, -4:] = 0
    rows[10:20, -4] = rows[30:, -4] = 1  # the left heel touches twice
    axes = Figure().add_subplot()
    prompts = [(0, "a person stands"), (30, "a person walks"), (99, "never seen")]
    draw_strip(axes, Motion(stick_motion.rig, 0, rows), prompts, GOALS, from_s=0.0, to_s=2.0, every_s=0.5)
    words = [text.get_text() for text in axes.texts]
    assert {"0 s", "0.5 s", "1 s", "1.5 s"} <= set(words)
    assert {"a person stands", "a person walks", "left heel", "right toe"} <= set(words)
    assert "never seen" not in words
    assert "2 m ahead: 10 cm off" in words
    assert "much later: not due" in words
    bars = [len(each.get_paths()) for each in axes.collections if type(each).__name__ == "PolyCollection"]
    assert bars == [2, 0, 0, 0]


def test_sheets_are_written_as_png(stick_motion: Motion, tmp_path: Path) -> None:
    scene = Scene("1  story", stick_motion, [(0, "a person stands")], GOALS)
    write_story(tmp_path / "one.png", scene, row_s=1.0)
    write_scenes(tmp_path / "two.png", [scene, scene])
    for name in ("one.png", "two.png"):
        assert (tmp_path / name).read_bytes().startswith(b"\x89PNG")


def test_nothing_to_draw_is_refused(stick_motion: Motion, tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="one scene or more"):
        write_scenes(tmp_path / "none.png", [])
    empty = Motion(stick_motion.rig, 0, stick_motion.rows[:0])
    with pytest.raises(InvalidInput, match="one frame or more"):
        write_story(tmp_path / "none.png", Scene("", empty, [], ()))
