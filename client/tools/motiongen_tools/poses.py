"""Draw skeletons from the side, and paths over the ground from above. The left side is blue, the right side red."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from motiongen_client.kinematics import facing_rad, heading_rad, quaternion_to_matrix
from motiongen_client.motion import Motion, Rig

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEFT, RIGHT, MIDDLE = "#2f6db3", "#cf4a4a", "#3b3f45"
GROUND, QUIET, GOAL = "#c9ccd1", "#7c828b", "#1a9850"
SLOT_M = 1.15  # distance between the poses of a strip
HEADROOM_M = 2.15
_CAMERA_AZIMUTH_RAD = np.radians(-40)  # from the character's right front, so that walking forward is to the right
_MIN_GROUND_SPAN_M = 2.0


def headings_rad(motion: Motion) -> NDArray[np.float64]:
    """(T,) headings: from the line of the hips if the rig names them, otherwise from the root's rotation."""
    if motion.rig.hip_joints is None:
        return heading_rad(quaternion_to_matrix(motion.joint_rotation_quat_wxyz[:, 0])).astype(np.float64)
    return facing_rad(motion.joint_positions_m(), motion.rig.hip_joints).astype(np.float64)


def project(positions: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(..., 3) metres -> (..., 2) right and up on the page, and (...) depth towards the viewer."""
    cosine, sine = np.cos(_CAMERA_AZIMUTH_RAD), np.sin(_CAMERA_AZIMUTH_RAD)
    x, y, z = np.moveaxis(positions, -1, 0)
    return np.stack([x * cosine - z * sine, y], axis=-1), x * sine + z * cosine


def draw_poses(axes: Axes, motion: Motion, rows: NDArray[np.int_], at: NDArray[np.float64]) -> None:
    """Draw the poses of some rows of a motion side by side, the root of pose i above at[i] on the page."""
    from matplotlib.collections import LineCollection
    from matplotlib.patches import Circle

    positions = Motion(motion.rig, 0, motion.rows[rows]).joint_positions_m().astype(np.float64)
    flat, depth = project(positions - positions[:, :1] * np.array([1, 0, 1]))
    colours, heads = _bone_colours(motion.rig), _heads(motion.rig)
    parents = np.array(motion.rig.parents[1:])
    for slot, (place, pose) in enumerate(zip(at, flat, strict=True)):
        pose = pose + np.array([place, 0.0])
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
            axes.add_patch(Circle((pose[head, 0], pose[head, 1] + 0.07), 0.095, color=MIDDLE, linewidth=0))


def draw_way(axes: Axes, motion: Motion, *, every_s: float = 1.0, arrow_width: float = 0.012) -> None:
    """Draw the path of the root: an arrow for the heading every every_s, a circle at the start, a square at the end."""
    x, z = motion.root_translation_m[:, 0], motion.root_translation_m[:, 2]
    axes.plot(x, z, color=MIDDLE, linewidth=1.3, solid_capstyle="round")
    every = np.arange(0, len(motion), max(motion.rig.frames_in(every_s), 1))
    facing = headings_rad(motion)[every]
    axes.quiver(
        x[every], z[every], np.sin(facing), np.cos(facing),
        color=QUIET, angles="xy", scale=9 * 0.012 / arrow_width, width=arrow_width, headwidth=4, headlength=4,
    )  # fmt: skip
    axes.plot(x[:1], z[:1], "o", color=MIDDLE, markersize=4)
    axes.plot(x[-1:], z[-1:], "s", color=MIDDLE, markersize=4)


def frame_ground(axes: Axes, points: NDArray[np.float64]) -> None:
    """Fit the page to (N, 2) points x, z, seen from above while facing +Z: +Z is up the page, +X to the left."""
    middle, span = (points.min(0) + points.max(0)) / 2, max(np.ptp(points, axis=0).max() * 1.2, _MIN_GROUND_SPAN_M)
    axes.set_xlim(middle[0] + span / 2, middle[0] - span / 2)
    axes.set_ylim(middle[1] - span / 2, middle[1] + span / 2)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=6, length=2, pad=1, colors=QUIET)
    axes.grid(color="#eceef0", linewidth=0.6)
    axes.set_axisbelow(True)
    for spine in axes.spines.values():
        spine.set_color(GROUND)


def _bone_colours(rig: Rig) -> list[str]:
    """A colour for the bone that ends at each joint except the root."""

    def colour(name: str) -> str:
        lowered = name.lower()
        return LEFT if lowered.startswith("left") else RIGHT if lowered.startswith("right") else MIDDLE

    return [colour(name) for name in rig.joint_names[1:]]


def _heads(rig: Rig) -> list[int]:
    return [joint for joint, name in enumerate(rig.joint_names) if name.lower() == "head"]
