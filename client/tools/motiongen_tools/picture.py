"""Motion as a picture: the path seen from above, and a strip of skeletons over time.

Needs matplotlib: `pip install 'motiongen-tools[pictures]'`. Left limbs are blue, right limbs red, everything else dark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, MissingExtra
from motiongen_client.motion import Motion
from motiongen_client.types import Waypoint
from motiongen_tools.picture_text import as_written
from motiongen_tools.poses import GOAL, GROUND, HEADROOM_M, QUIET, SLOT_M, draw_poses, draw_way, frame_ground
from motiongen_tools.whole_file import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class Panel:
    """One character of a picture. notes: (frame, text) of events, such as a change of prompt."""

    title: str
    motion: Motion
    waypoints: Sequence[Waypoint] = ()
    notes: Sequence[tuple[int, str]] = ()


def write_picture(path: Path | str, panels: Sequence[Panel], *, num_poses: int = 14, dpi: int = 110) -> None:
    """Write a PNG with one row per panel: the path from above, then num_poses skeletons, evenly spaced in time.

    Raises InvalidInput if there are no panels or frames, MissingExtra without matplotlib.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra("drawing a picture", "matplotlib", "pictures") from None
    if not panels or any(len(panel.motion) == 0 for panel in panels):
        raise InvalidInput("panels", f"{len(panels)} panels", "one panel or more, each with one frame or more")
    figure = Figure(figsize=(13.5, 1.95 * len(panels) + 0.2), dpi=dpi, layout="constrained", facecolor="white")
    grid = figure.add_gridspec(len(panels), 2, width_ratios=[1.7, 11.8])
    for row, panel in enumerate(panels):
        _draw_path(figure.add_subplot(grid[row, 0]), panel)
        _draw_strip(figure.add_subplot(grid[row, 1]), panel, num_poses)
    with whole_file(path) as part:
        figure.savefig(part, format="png")


def _draw_path(axes: Axes, panel: Panel) -> None:
    """Draw the path over the ground, the waypoints, and where the character was at their frames."""
    motion = panel.motion
    draw_way(axes, motion)
    for waypoint in panel.waypoints:
        axes.plot([waypoint.x_m], [waypoint.z_m], "x", color=GOAL, markersize=8, markeredgewidth=2)
        if 0 <= waypoint.frame - motion.first_frame < len(motion):
            reached = motion.frame(waypoint.frame).root_translation_m
            axes.plot([reached[0]], [reached[2]], "o", color=GOAL, markersize=4)
    places = np.array([(point.x_m, point.z_m) for point in panel.waypoints]).reshape(-1, 2)
    frame_ground(axes, np.concatenate([motion.root_translation_m[:, [0, 2]], places]))


def _draw_strip(axes: Axes, panel: Panel, num_poses: int) -> None:
    """Draw skeletons from left to right in time, without their displacement, which only the path panel shows."""
    motion = panel.motion
    rows = np.linspace(0, len(motion) - 1, min(num_poses, len(motion))).round().astype(int)
    at = np.arange(len(rows), dtype=np.float64) * SLOT_M
    draw_poses(axes, motion, rows, at)
    for place, row in zip(at, rows, strict=True):
        seconds = (motion.first_frame + row) / motion.rig.frame_rate_hz
        axes.text(place, -0.06, f"{seconds:.1f} s", ha="center", va="top", fontsize=6.5, color=QUIET)
    axes.axhline(0, color=GROUND, linewidth=1, zorder=0)
    _write_notes(axes, panel, rows)
    axes.set_title(as_written(panel.title), loc="left", fontsize=9.5, color="#111111", pad=3)
    axes.set_xlim(-0.8, (num_poses - 1) * SLOT_M + 0.8)
    axes.set_ylim(-0.3, HEADROOM_M)
    axes.set_aspect("equal", anchor="W")
    axes.set_axis_off()


def _write_notes(axes: Axes, panel: Panel, rows: NDArray[np.int_]) -> None:
    frames = panel.motion.first_frame + rows
    for frame, text in panel.notes:
        slot = np.interp(frame, frames, np.arange(len(rows)))
        axes.plot([slot * SLOT_M] * 2, [0, HEADROOM_M - 0.05], color=GOAL, linewidth=1, linestyle=(0, (4, 3)))
        axes.text(slot * SLOT_M + 0.05, HEADROOM_M - 0.02, as_written(text), fontsize=8, color=GOAL, va="top")
