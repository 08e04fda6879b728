"""A path from above: goals as stars, where the character was at their frames, and the distances between them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motiongen_client.motion import Motion
from motiongen_client.types import JointTargets, RootTrajectory, Waypoint
from motiongen_tools.demo.goals import Facing, Goal, measure
from motiongen_tools.poses import GOAL, QUIET, draw_way, frame_ground

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TICK_S = 2.0
_NEAR_M = 0.3  # nearer than this, texts would overlap


def draw_ground(axes: Axes, motion: Motion, goals: Sequence[Goal]) -> None:
    """Draw the path with arrows for the heading and times; goals are green."""
    draw_way(axes, motion, every_s=0.5, arrow_width=0.006)
    root = motion.root_translation_m[:, [0, 2]].astype(np.float64)
    points, places = [root], list[NDArray[np.float64]]()
    for goal in goals:
        match goal.aim:
            case Waypoint(frame=frame, x_m=x, z_m=z):
                spot = np.array([x, z])
                points.append(spot[None])
                axes.plot([x], [z], "*", color=GOAL, markersize=13, zorder=4)
                above = sum(bool(np.linalg.norm(spot - other) < _NEAR_M) for other in places)
                places.append(spot)
                _draw_miss(axes, motion, goal, frame, spot, above)
            case JointTargets(frame=frame, joints=joints, positions_m=positions):
                place = positions[-1, [0, 2]].astype(np.float64)
                points.append(place[None])
                axes.plot(*place, "*", color=GOAL, markersize=9, zorder=4)
                if 0 <= frame - motion.first_frame < len(motion):
                    hand = motion.frame(frame).joint_positions_m()[joints[-1], [0, 2]]
                    axes.plot([place[0], hand[0]], [place[1], hand[1]], "-", color=GOAL, linewidth=1)
            case RootTrajectory(positions_m=positions):
                points.append(positions.astype(np.float64))
                axes.plot(positions[:, 0], positions[:, 1], "--", color=GOAL, linewidth=1.2)
            case Facing(frame=frame, heading_rad=heading) if 0 <= frame - motion.first_frame < len(motion):
                at = root[frame - motion.first_frame]
                tip = at + 0.5 * np.array([np.sin(heading), np.cos(heading)])
                axes.annotate("", tip, at, arrowprops={"arrowstyle": "->", "color": GOAL, "linewidth": 1.8})
                points.append(tip[None])
    _draw_times(axes, motion, root)
    frame_ground(axes, np.concatenate(points))


def _draw_times(axes: Axes, motion: Motion, root: NDArray[np.float64]) -> None:
    """Draw the time every other second, except while the character stands."""
    last = np.full(2, np.inf)
    for row in range(0, len(motion), max(motion.rig.frames_in(_TICK_S), 1)):
        if np.linalg.norm(root[row] - last) > _NEAR_M:
            seconds, last = (motion.first_frame + row) / motion.rig.frame_rate_hz, root[row]
            at = float(last[0]), float(last[1])
            axes.annotate(f"{seconds:g} s", at, (5, -9), textcoords="offset points", fontsize=6.5, color=QUIET)


def _draw_miss(axes: Axes, motion: Motion, goal: Goal, frame: int, place: NDArray[np.float64], above: int) -> None:
    """Draw a line from the star to where the character was at its frame, and the distance, `above` lines up."""
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
        (9, 5 + 10 * above),
        textcoords="offset points",
        fontsize=8,
        color=GOAL,
        fontweight="bold",
    )
