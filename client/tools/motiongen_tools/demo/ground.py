"""A way from above: goals as stars, where the character was at their frames, and the distance between the two."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motiongen_client.motion import Motion
from motiongen_client.types import JointTargets, Trajectory, Waypoint
from motiongen_tools.demo.goals import Facing, Goal, measure
from motiongen_tools.poses import GOAL, QUIET, draw_way, frame_ground

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TICK_S = 2.0


def draw_ground(axes: Axes, motion: Motion, goals: Sequence[Goal]) -> None:
    """The way with arrows of the facing and times, and what was asked of it in green."""
    draw_way(axes, motion, every_s=0.5, arrow_width=0.006)
    root, rate = motion.root_translation_m[:, [0, 2]].astype(np.float64), motion.rig.frame_rate_hz
    for row in range(0, len(motion), max(motion.rig.frames_in(_TICK_S), 1)):
        seconds = (motion.first_frame + row) / rate
        axes.annotate(f"{seconds:g} s", root[row], (5, -9), textcoords="offset points", fontsize=6.5, color=QUIET)
    points = [root]
    for goal in goals:
        match goal.aim:
            case Waypoint(frame=frame, x_m=x, z_m=z):
                points.append(np.array([[x, z]]))
                axes.plot([x], [z], "*", color=GOAL, markersize=13, zorder=4)
                _draw_miss(axes, motion, goal, frame, np.array([x, z]))
            case JointTargets(frame=frame, joints=joints, positions_m=positions):
                place = positions[-1, [0, 2]].astype(np.float64)
                points.append(place[None])
                axes.plot(*place, "*", color=GOAL, markersize=9, zorder=4)
                if 0 <= frame - motion.first_frame < len(motion):
                    hand = motion.frame(frame).joint_positions_m()[joints[-1], [0, 2]]
                    axes.plot([place[0], hand[0]], [place[1], hand[1]], "-", color=GOAL, linewidth=1)
            case Trajectory(positions_m=positions):
                points.append(positions.astype(np.float64))
                axes.plot(positions[:, 0], positions[:, 1], "--", color=GOAL, linewidth=1.2)
            case Facing(frame=frame, heading_rad=heading) if 0 <= frame - motion.first_frame < len(motion):
                at = root[frame - motion.first_frame]
                tip = at + 0.5 * np.array([np.sin(heading), np.cos(heading)])
                axes.annotate("", tip, at, arrowprops={"arrowstyle": "->", "color": GOAL, "linewidth": 1.8})
                points.append(tip[None])
    frame_ground(axes, np.concatenate(points))


def _draw_miss(axes: Axes, motion: Motion, goal: Goal, frame: int, place: NDArray[np.float64]) -> None:
    """From the star to where the character was at its frame, with the distance in centimetres."""
    reached = measure(goal, motion, place_m=1.0)
    if reached is None:
        return
    was = motion.frame(frame).root_translation_m[[0, 2]].astype(np.float64)
    axes.plot([place[0], was[0]], [place[1], was[1]], "-", color=GOAL, linewidth=1.2, zorder=3)
    axes.plot(*was, "o", color="white", markeredgecolor=GOAL, markersize=5, zorder=5)
    text = f"{reached.error:.0f} cm at {frame / motion.rig.frame_rate_hz:g} s"
    axes.annotate(
        text,
        (float(place[0]), float(place[1])),
        (9, 5),
        textcoords="offset points",
        fontsize=8,
        color=GOAL,
        fontweight="bold",
    )
