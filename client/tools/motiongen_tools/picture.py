"""Motion as a picture: the path seen from above, and a strip of skeletons over time.

Needs matplotlib: `pip install 'motiongen-client[pictures]'`. Left limbs are blue, right limbs red, the rest dark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, MissingExtra
from motiongen_client.kinematics import heading_rad, quaternion_to_matrix
from motiongen_client.motion import Motion, Rig
from motiongen_client.types import Waypoint

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LEFT, _RIGHT, _MIDDLE = "#2f6db3", "#cf4a4a", "#3b3f45"
_GROUND, _QUIET, _WAYPOINT = "#c9ccd1", "#7c828b", "#1a9850"
_CAMERA_AZIMUTH_RAD = np.radians(-40)  # from the character's right front, so that walking forward goes right
_SLOT_M = 1.15
_HEADROOM_M = 2.15
_MIN_PATH_SPAN_M = 2.0


@dataclass(frozen=True, eq=False)
class Panel:
    """One character of a contact sheet. notes: (frame, text) of what happened when, such as a change of prompt."""

    title: str
    motion: Motion
    waypoints: Sequence[Waypoint] = ()
    notes: Sequence[tuple[int, str]] = ()


def write_picture(path: Path | str, panels: Sequence[Panel], *, num_poses: int = 14, dpi: int = 110) -> None:
    """Write a PNG with a row for each panel: path from above, then num_poses skeletons evenly over time.

    Raises InvalidInput without panels or frames, MissingExtra without matplotlib.
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
    figure.savefig(path, format="png")


def _draw_path(axes: Axes, panel: Panel) -> None:
    """The root over the ground: +Z up the page, +X to the left, as seen from above by someone facing +Z."""
    motion = panel.motion
    x, z = motion.root_translation_m[:, 0], motion.root_translation_m[:, 2]
    axes.plot(x, z, color=_MIDDLE, linewidth=1.3, solid_capstyle="round")
    every = np.arange(0, len(motion), motion.rig.frame_rate_hz)  # a mark a second, pointing where the root faces
    facing = heading_rad(quaternion_to_matrix(motion.joint_rotation_quat_wxyz[every, 0]))
    axes.quiver(
        x[every], z[every], np.sin(facing), np.cos(facing),
        color=_QUIET, angles="xy", scale=9, width=0.012, headwidth=4, headlength=4,
    )  # fmt: skip
    axes.plot(x[:1], z[:1], "o", color=_MIDDLE, markersize=4)
    axes.plot(x[-1:], z[-1:], "s", color=_MIDDLE, markersize=4)
    for waypoint in panel.waypoints:
        axes.plot([waypoint.x_m], [waypoint.z_m], "x", color=_WAYPOINT, markersize=8, markeredgewidth=2)
        if 0 <= waypoint.frame - motion.first_frame < len(motion):
            reached = motion.frame(waypoint.frame).root_translation_m
            axes.plot([reached[0]], [reached[2]], "o", color=_WAYPOINT, markersize=4)
    points = np.array([*zip(x, z, strict=True), *((point.x_m, point.z_m) for point in panel.waypoints)])
    middle, span = (points.min(0) + points.max(0)) / 2, max(np.ptp(points, axis=0).max() * 1.2, _MIN_PATH_SPAN_M)
    axes.set_xlim(middle[0] + span / 2, middle[0] - span / 2)
    axes.set_ylim(middle[1] - span / 2, middle[1] + span / 2)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6, length=2, pad=1, colors=_QUIET)
    axes.grid(color="#eceef0", linewidth=0.6)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(_GROUND)


def _draw_strip(axes: Axes, panel: Panel, num_poses: int) -> None:
    """Skeletons from left to right in time, each in place: only the path panel shows where they went."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle

    motion = panel.motion
    rows = np.linspace(0, len(motion) - 1, min(num_poses, len(motion))).round().astype(int)
    positions = Motion(motion.rig, 0, motion.rows[rows]).joint_positions_m().astype(np.float64)
    flat, depth = _project(positions - positions[:, :1] * np.array([1, 0, 1]))
    colours, heads = _bone_colours(motion.rig), _heads(motion.rig)
    parents = np.array(motion.rig.parents[1:])
    for slot, (row, pose) in enumerate(zip(rows, flat, strict=True)):
        pose = pose + np.array([slot * _SLOT_M, 0.0])
        bones = np.stack([pose[parents], pose[1:]], axis=1)
        near_last = np.argsort((depth[slot, parents] + depth[slot, 1:]) / 2)
        axes.add_collection(
            LineCollection(
                [bones[bone] for bone in near_last],
                colors=[colours[bone] for bone in near_last],
                linewidths=2.0,
                capstyle="round",
            )
        )
        for head in heads:
            axes.add_patch(Circle((pose[head, 0], pose[head, 1] + 0.07), 0.095, color=_MIDDLE, linewidth=0))
        seconds = (motion.first_frame + row) / motion.rig.frame_rate_hz
        axes.text(slot * _SLOT_M, -0.06, f"{seconds:.1f} s", ha="center", va="top", fontsize=6.5, color=_QUIET)
    axes.axhline(0, color=_GROUND, linewidth=1, zorder=0)
    _write_notes(axes, panel, rows)
    axes.set_title(panel.title, loc="left", fontsize=9.5, color="#111111", pad=3)
    axes.set_xlim(-0.8, (num_poses - 1) * _SLOT_M + 0.8)
    axes.set_ylim(-0.3, _HEADROOM_M)
    axes.set_aspect("equal", anchor="W")
    axes.set_axis_off()


def _write_notes(axes: Axes, panel: Panel, rows: NDArray[np.int_]) -> None:
    frames = panel.motion.first_frame + rows
    for frame, text in panel.notes:
        slot = np.interp(frame, frames, np.arange(len(rows)))
        axes.plot([slot * _SLOT_M] * 2, [0, _HEADROOM_M - 0.05], color=_WAYPOINT, linewidth=1, linestyle=(0, (4, 3)))
        axes.text(slot * _SLOT_M + 0.05, _HEADROOM_M - 0.02, text, fontsize=8, color=_WAYPOINT, va="top")


def _project(positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(..., 3) metres -> (..., 2) right and up on the page, and (...) towards the viewer."""
    cosine, sine = np.cos(_CAMERA_AZIMUTH_RAD), np.sin(_CAMERA_AZIMUTH_RAD)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([x * cosine - z * sine, y], axis=-1), x * sine + z * cosine


def _bone_colours(rig: Rig) -> list[str]:
    """A colour for the bone that ends at each joint but the root."""

    def colour(name: str) -> str:
        lowered = name.lower()
        return _LEFT if lowered.startswith("left") else _RIGHT if lowered.startswith("right") else _MIDDLE

    return [colour(name) for name in rig.joint_names[1:]]


def _heads(rig: Rig) -> list[int]:
    return [joint for joint, name in enumerate(rig.joint_names) if name.lower() == "head"]
