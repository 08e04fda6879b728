"""The contact sheets: for each character, its path from above, and its poses, prompts, goals and contacts over time.

Needs matplotlib: `pip install 'motiongen-tools[pictures]'`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from motiongen_client.errors import InvalidInput, MissingExtra
from motiongen_client.motion import Motion
from motiongen_tools.demo.goals import Goal
from motiongen_tools.demo.ground import draw_ground
from motiongen_tools.demo.strip import draw_strip
from motiongen_tools.whole_file import whole_file

_DPI = 100


@dataclass(frozen=True, eq=False)
class Scene:
    """One character. prompts: (frame, text) in order of time, each until the next; goals: what else was asked for."""

    title: str
    motion: Motion
    prompts: Sequence[tuple[int, str]]
    goals: Sequence[Goal]


def write_story(path: Path | str, scene: Scene, *, every_s: float = 0.5, row_s: float = 6.5) -> None:
    """Write a PNG of one character at length: its path, and rows of row_s seconds with a pose every every_s.

    Raises InvalidInput if there are no frames, MissingExtra without matplotlib.
    """
    _write(path, [scene], every_s, row_s)


def write_scenes(path: Path | str, scenes: Sequence[Scene], *, every_s: float = 1.25) -> None:
    """Write a PNG of several characters, one row each with a pose every every_s. Raises as `write_story`."""
    if not scenes:
        raise InvalidInput("scenes", scenes, "one scene or more")
    _write(path, scenes, every_s, max(scene.motion.duration_s for scene in scenes))


def _write(path: Path | str, scenes: Sequence[Scene], every_s: float, row_s: float) -> None:
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra("drawing a picture", "matplotlib", "pictures") from None
    if any(len(scene.motion) == 0 for scene in scenes):
        raise InvalidInput("scenes", f"{len(scenes)} scenes", "scenes with one frame or more each")
    rows = [max(math.ceil(scene.motion.duration_s / row_s - 1e-6), 1) for scene in scenes]
    figure = Figure(figsize=(17, 2.95 * sum(rows) + 0.2), dpi=_DPI, layout="constrained", facecolor="white")
    grid = figure.add_gridspec(sum(rows), 2, width_ratios=[3.6, 13.4] if len(rows) > 1 else [5, 12])
    above = 0
    for scene, count in zip(scenes, rows, strict=True):
        ground = figure.add_subplot(grid[above : above + count, 0])
        draw_ground(ground, scene.motion, scene.goals)
        ground.set_title(scene.title, loc="left", fontsize=11, color="#111111")
        for row in range(count):
            strip = figure.add_subplot(grid[above + row, 1])
            from_s, to_s = row * row_s, (row + 1) * row_s
            draw_strip(strip, scene.motion, scene.prompts, scene.goals, from_s=from_s, to_s=to_s, every_s=every_s)
        above += count
    with whole_file(path) as part:
        figure.savefig(part, format="png")
