"""A character over time: poses from the side; below them prompts, goals, and which foot touches the ground."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from motiongen_client.motion import CONTACT_BLOCK, Motion
from motiongen_client.types import JointTargets
from motiongen_tools.demo.goals import Goal, measure
from motiongen_tools.poses import GOAL, GROUND, HEADROOM_M, LEFT, QUIET, RIGHT, SLOT_M, draw_poses, project

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PROMPT_COLOURS = ("#e8eef6", "#f6efe2")
_LINE_M = 0.23  # spacing of the lines below the ground, in metres of the page
_FEET = (("left heel", LEFT), ("left toe", LEFT), ("right heel", RIGHT), ("right toe", RIGHT))


def draw_strip(
    axes: Axes,
    motion: Motion,
    prompts: Sequence[tuple[int, str]],
    goals: Sequence[Goal],
    *,
    from_s: float,
    to_s: float,
    every_s: float,
) -> None:
    """Draw a motion from from_s to to_s, a pose every every_s without its displacement, the root above its time."""
    rate, end = motion.rig.frame_rate_hz, motion.first_frame + len(motion)

    def at(frame: float) -> float:
        return (frame / rate - from_s) / every_s * SLOT_M

    first, last = round(from_s * rate), min(round(to_s * rate), end)
    frames = np.arange(first, last, max(round(every_s * rate), 1))
    frames = frames[(frames >= motion.first_frame) & (frames < end)]
    if len(frames):
        draw_poses(axes, motion, frames - motion.first_frame, np.array([at(int(frame)) for frame in frames]))
    for frame in frames:
        axes.text(at(int(frame)), -0.05, f"{frame / rate:g} s", ha="center", va="top", fontsize=7, color=QUIET)
    axes.axhline(0, color=GROUND, linewidth=1, zorder=0)
    _draw_prompts(axes, prompts, first, last, at)
    low = _draw_goals(axes, motion, goals, first, last, at)
    low = _draw_contacts(axes, motion, first, last, at, low)
    axes.set_xlim(-0.95, (to_s - from_s) / every_s * SLOT_M + 0.3)
    axes.set_ylim(low, HEADROOM_M)
    axes.set_aspect("equal", anchor="NW")
    axes.set_axis_off()


def _draw_prompts(
    axes: Axes, prompts: Sequence[tuple[int, str]], first: int, last: int, at: Callable[[float], float]
) -> None:
    """Draw a band for each prompt, from the frame at which it shows to the next one's; its text is cut off there."""
    from matplotlib.patches import Rectangle

    ends = [frame for frame, _ in prompts[1:]] + [last]
    for number, ((start, text), end) in enumerate(zip(prompts, ends, strict=True)):
        left, right = max(start, first), min(end, last)
        if left >= right:
            continue
        colour = _PROMPT_COLOURS[number % len(_PROMPT_COLOURS)]
        band = axes.add_patch(Rectangle((at(left), -0.5), at(right) - at(left), 0.24, color=colour, linewidth=0))
        written = axes.text(at(left) + 0.04, -0.38, text, fontsize=8, va="center", color="#111111", clip_on=True)
        written.set_clip_path(band)


def _draw_goals(
    axes: Axes, motion: Motion, goals: Sequence[Goal], first: int, last: int, at: Callable[[float], float]
) -> float:
    """Draw a line for each goal, from when it was asked for to when it is due, with its error. Returns the lowest y."""
    low, taken_to = -0.5, -np.inf
    for goal in goals:
        start, end = goal.asked_frame, goal.frames.stop - 1
        if start >= last or end < first:
            continue
        if at(start) < taken_to or low == -0.5:
            low -= _LINE_M
        middle = low + 0.05
        axes.plot([at(max(start, first)), at(min(end, last))], [middle] * 2, color=GOAL, linewidth=1.2)
        reached = measure(goal, motion, place_m=1.0)
        miss = "not due" if reached is None else f"{reached.error:.{0 if goal.unit == 'cm' else 1}f} {goal.unit} off"
        if first <= end < last:
            axes.plot([at(end)], [middle], "*", color=GOAL, markersize=9)
        text = f"{goal.label}: {miss}"
        axes.text(at(max(start, first)) + 0.04, middle + 0.03, text, fontsize=7, color=GOAL, va="bottom", clip_on=True)
        taken_to = max(at(end), at(max(start, first)) + 0.09 * len(text))
        if isinstance(goal.aim, JointTargets) and first <= end < min(last, motion.first_frame + len(motion)):
            offset = goal.aim.positions_m[-1] - motion.frame(end).root_translation_m * np.array([1, 0, 1])
            flat, _ = project(offset.astype(np.float64))
            axes.plot([at(end) + flat[0]], [flat[1]], "*", color=GOAL, markersize=9, zorder=5)
    return low


def _draw_contacts(
    axes: Axes, motion: Motion, first: int, last: int, at: Callable[[float], float], top: float
) -> float:
    """Draw bars while heel and toe of each foot touch the ground. Returns the lowest y."""
    rows = motion.foot_contact if CONTACT_BLOCK in motion.rig.blocks else np.zeros((0, 0), np.float32)
    low = top - 0.1
    for column, (name, colour) in enumerate(_FEET[: rows.shape[1]]):
        low -= 0.13
        touches = np.concatenate(
            [[False], rows[max(first - motion.first_frame, 0) : last - motion.first_frame, column] > 0.5, [False]]
        )
        edges = np.flatnonzero(np.diff(touches.astype(int))) + max(first, motion.first_frame)
        spans = [(at(start), at(end) - at(start)) for start, end in edges.reshape(-1, 2)]
        axes.broken_barh(spans, (low, 0.09), color=colour, linewidth=0)
        axes.text(-0.45, low + 0.045, name, fontsize=6, ha="right", va="center", color=QUIET)
    return low - 0.08
