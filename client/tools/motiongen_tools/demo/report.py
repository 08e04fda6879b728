"""The printed report of a demo: prompts and what was done under them, goals and how near each came, figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from motiongen_client.motion import Motion
from motiongen_tools.console import make_table
from motiongen_tools.demo.goals import Goal, Reached, measure
from motiongen_tools.demo.play import Take
from motiongen_tools.poses import headings_rad

if TYPE_CHECKING:
    from rich.console import Console
    from rich.text import Text


@dataclass(frozen=True)
class Deed:
    """What a character did while one prompt was in force."""

    from_s: float
    to_s: float
    text: str
    travelled_m: float
    turned_deg: float  # to the left

    @property
    def turned(self) -> str:
        """The turn in words."""
        return f"{round(self.turned_deg)} degrees"  # a whole number has no minus zero


def deeds(motion: Motion, prompts: Sequence[tuple[int, str]]) -> list[Deed]:
    """A deed for each prompt that was in force for two frames or more. prompts: (frame, text), in order of time."""
    facing, rate, end = np.unwrap(headings_rad(motion)), motion.rig.frame_rate_hz, motion.first_frame + len(motion)
    found = []
    for (start, text), stop in zip(prompts, [frame for frame, _ in prompts[1:]] + [end], strict=True):
        first, last = max(start, motion.first_frame), min(stop, end) - 1
        if last <= first:
            continue
        rows = slice(first - motion.first_frame, last - motion.first_frame + 1)
        turned = math.degrees(facing[rows][-1] - facing[rows][0])
        walked = travelled_m(Motion(motion.rig, first, motion.rows[rows]))
        found.append(Deed(first / rate, (last + 1) / rate, text, walked, turned))
    return found


def travelled_m(motion: Motion) -> float:
    """Length of the root's path over the ground, metres."""
    steps = np.diff(motion.root_translation_m[:, [0, 2]], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())


def missed_places(take: Take, place_m: float) -> list[str]:
    """A line for each waypoint that was missed by more than place_m."""
    motion, missed = take.motion(), []
    for goal in take.goals if motion is not None else []:
        reached = None if motion is None else measure(goal, motion, place_m)
        if goal.is_place and reached is not None and not reached.is_within:
            missed.append(f"{goal.label}: missed by {reached.error:.0f} cm, more than {100 * place_m:g}")
    return missed


def print_report(takes: Sequence[Take], place_m: float, console: Console) -> None:
    """Print the story, everyone's goals, the warnings and the figures."""
    story = takes[0].motion()
    if story is not None:
        table = make_table("The story", "prompt", "from", "to", "travelled", "turned left")
        for deed in deeds(story, takes[0].prompts):
            times = (f"{deed.from_s:.1f} s", f"{deed.to_s:.1f} s")
            table.add_row(deed.text, *times, f"{deed.travelled_m:.1f} m", deed.turned)
        console.print(table)
    table = make_table("Goals", "asked for", "due", "off by", "within bound from")
    for take in takes:
        motion = take.motion()
        for goal in take.goals if motion is not None else []:
            reached = None if motion is None else measure(goal, motion, place_m)
            table.add_row(
                f"{take.role.name}: {goal.label}", *_goal_cells(goal, reached, take.session.rig.frame_rate_hz)
            )
    console.print(table)
    for take in takes:
        for warning in take.warnings:
            console.print(f"warning for {take.role.name}: {warning.message}", soft_wrap=True)
    if not any(take.warnings for take in takes):
        console.print("no warnings: the script stays within what the model knows")
    _print_figures(takes, console)


def _goal_cells(goal: Goal, reached: Reached | None, frame_rate_hz: int) -> tuple[str, str | Text, str]:
    from rich.text import Text

    due = f"{(goal.frames.stop - 1) / frame_rate_hz:.1f} s"
    if reached is None:
        return due, "not due yet", "-"
    off = f"{reached.error:.{0 if goal.unit == 'cm' else 1}f} {goal.unit}"
    since = "never" if reached.reached_s is None else f"{reached.reached_s:.1f} s"
    return due, off if reached.is_within else Text(off, style="red"), since


def _print_figures(takes: Sequence[Take], console: Console) -> None:
    motions = [motion for take in takes if (motion := take.motion()) is not None]
    num_frames, seconds = sum(map(len, motions)), sum(motion.duration_s for motion in motions)
    wall_s = max((take.wall_s for take in takes), default=0.0)
    firsts = [take.session.stats.first_frame_s for take in takes]
    latencies = [edit.latency_s for take in takes for edit in take.edits]
    windows = sum(take.session.stats.plans for take in takes)
    late = sum(take.session.stats.late_plans for take in takes)
    speed = seconds / wall_s if wall_s > 0 else 0.0
    console.print(
        f"{num_frames} frames, {seconds:.0f} s of motion, in {wall_s:.1f} s: {speed:.1f} times real time; "
        f"{windows} windows; first frame after {milliseconds(firsts)} (p50), an event shows after "
        f"{milliseconds(latencies)} (p50) of {len(latencies)}; plans that came too late for the playhead: {late}",
        soft_wrap=True,
    )


def milliseconds(seconds: Sequence[float | None], percentile: float = 50) -> str:
    """A percentile of the known values, in milliseconds; a dash if there are none."""
    known = [each for each in seconds if each is not None]
    return f"{1000 * float(np.percentile(known, percentile)):.0f} ms" if known else "-"
