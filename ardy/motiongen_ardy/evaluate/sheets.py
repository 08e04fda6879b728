"""PNG sheets: poses from the side, paths from above with goals and facing, heights of the feet over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.collections import LineCollection

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.evaluate.context import Exhibit
from motiongen_ardy.evaluate.measures.feet import foot_trace
from motiongen_ardy.evaluate.take import Result

MAX_ROWS = 14
NUM_POSES = 26
_COLOURS = {"left": "tab:blue", "right": "tab:red", "middle": "0.2"}


def draw_sheet(exhibits: Sequence[Exhibit], layout: Representation, png: Path) -> None:
    """Draw one row per take, at most MAX_ROWS, spread evenly over the takes."""
    chosen = [exhibits[index] for index in _spread(len(exhibits))]
    figure, axes = plt.subplots(
        len(chosen), 3, figsize=(22, 2.6 * len(chosen)), width_ratios=(6, 1.6, 2), squeeze=False, layout="constrained"
    )
    for (side, above, feet), exhibit in zip(axes, chosen, strict=True):
        _side(side, exhibit, layout)
        _above(above, exhibit, layout)
        _feet(feet, exhibit.result, layout)
    figure.savefig(png, dpi=60)
    plt.close(figure)


def _spread(count: int) -> list[int]:
    if count <= MAX_ROWS:
        return list(range(count))
    return sorted({round(index * (count - 1) / (MAX_ROWS - 1)) for index in range(MAX_ROWS)})


def colour(skeleton: Skeleton, joint: int) -> str:
    """Left limbs blue, right limbs red, the rest dark."""
    name = skeleton.joint_names[joint].lower()
    return next((_COLOURS[side] for side in ("left", "right") if name.startswith(side)), _COLOURS["middle"])


def _side(axes: plt.Axes, exhibit: Exhibit, layout: Representation) -> None:
    """Poses at their true places along the path's main direction; those on the spot are spread apart."""
    skeleton, result = layout.skeleton, exhibit.result
    positions = result.positions.double().numpy()
    frames = np.linspace(0, len(positions) - 1, min(NUM_POSES, len(positions))).round().astype(int)
    axis = _main_direction(positions[:, 0][:, [0, 2]])
    along = positions[..., [0, 2]] @ axis
    length = float(np.ptp(along[:, 0]))
    apart = max(0.0, 0.45 - length / len(frames))
    bones, colours = [], []
    for place, frame in enumerate(frames):
        flat = np.stack([along[frame] + apart * place, positions[frame, :, 1]], axis=-1)
        bones += [(flat[joint], flat[skeleton.parents[joint]]) for joint in range(1, skeleton.num_joints)]
        colours += [colour(skeleton, joint) for joint in range(1, skeleton.num_joints)]
        if place % 3 == 0:
            axes.text(flat[0, 0], -0.3, f"{frame / layout.fps:.1f}", ha="center", fontsize=7)
    axes.add_collection(LineCollection(bones, colors=colours, linewidths=1.1))
    axes.axhline(0, color="tab:green", linewidth=0.6)
    lowest, highest = (float(pick(along[frames, 0] + apart * np.arange(len(frames)))) for pick in (np.min, np.max))
    axes.set(xlim=(lowest - 0.7, highest + 0.7), ylim=(-0.4, 2.1), aspect="equal")
    begin = "" if not result.take.history_len else f" (history to {result.take.history_len / layout.fps:.1f} s)"
    axes.set_title(exhibit.title + begin, fontsize=9, loc="left")
    axes.tick_params(labelsize=6, labelbottom=apart == 0.0)  # no metres along a strip that is spread apart


def _main_direction(ground: np.ndarray) -> np.ndarray:
    """The direction (2) in which a path (T, 2) extends the most, with the sign of its overall movement."""
    centred = ground - ground.mean(axis=0)
    if np.ptp(centred, axis=0).max() < 0.05:
        return np.array([0.0, 1.0])
    axis = np.linalg.svd(centred, full_matrices=False)[2][0]
    return np.asarray(axis * (1 if (ground[-1] - ground[0]) @ axis >= 0 else -1))


def _above(axes: plt.Axes, exhibit: Exhibit, layout: Representation) -> None:
    """The root's path with its facing every half second; stars are goals, the dashed line is the path asked for."""
    result = exhibit.result
    root, facing = result.root.numpy(), result.facing(layout.skeleton).numpy()
    axes.plot(root[:, 0], root[:, 1], color="0.2", linewidth=1)
    if exhibit.path is not None:
        axes.plot(exhibit.path[:, 0], exhibit.path[:, 1], "--", color="tab:orange", linewidth=1)
    every = slice(0, None, max(1, layout.fps // 2))
    axes.quiver(
        root[every, 0], root[every, 1], np.sin(facing[every]), np.cos(facing[every]),
        color="tab:purple", width=0.008, scale=14, angles="xy",
    )  # fmt: skip
    for frame, x, z in exhibit.goals:
        axes.plot(x, z, "*", color="tab:red", markersize=10)
        axes.text(x, z, f" {frame / layout.fps:.1f} s", fontsize=7)
    axes.plot(*root[0], "o", color="tab:green", markersize=4)
    # At least a metre is shown, so that a standing character looks like one.
    axes.plot(root[0, 0] + np.array([-0.5, 0.5]), root[0, 1] + np.array([-0.5, 0.5]), alpha=0.0)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.15)
    axes.invert_xaxis()  # seen from above with +Z up the page, +X is to the left
    axes.tick_params(labelsize=6)


def _feet(axes: plt.Axes, result: Result, layout: Representation) -> None:
    """Heights of the toes, and where contact labels say that they stand; grey lines are window seams."""
    heights = foot_trace(layout.skeleton, result.positions).numpy()
    contacts = (result.features[:, layout.contact_block] > 0.5).numpy()
    time = np.arange(len(heights)) / layout.fps
    for side, (name, labels) in enumerate((("left", contacts[:, :2]), ("right", contacts[:, 2:]))):
        axes.plot(time, heights[:, side], color=_COLOURS[name], linewidth=1)
        standing = np.where(labels.any(axis=1), -0.015 * (side + 1), math.nan)
        axes.plot(time, standing, color=_COLOURS[name], linewidth=3)
    for start in result.window_starts:
        axes.axvline(start / layout.fps, color="0.85", linewidth=0.8, zorder=0)
    axes.set_ylim(-0.05, 0.3)
    axes.set_title("toe heights, contacts", fontsize=8, loc="left")
    axes.tick_params(labelsize=6)
