"""`motiongen stream`: write one character's motion to files."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motiongen_client.motion import Motion, Rig
from motiongen_client.session import Session
from motiongen_client.types import SessionOptions, Waypoint
from motiongen_tools.arguments import check_file_to_write
from motiongen_tools.bvh import write_bvh
from motiongen_tools.connection import client_of
from motiongen_tools.console import make_console, make_progress, make_table
from motiongen_tools.npz import write_npz
from motiongen_tools.picture import Panel, write_picture


@dataclass(frozen=True)
class TimedWaypoint:
    """A waypoint as typed: world metres, radians, and seconds instead of a frame."""

    at_s: float
    x_m: float
    z_m: float
    heading_rad: float | None = None

    def in_frames(self, rig: Rig, num_frames: int) -> Waypoint:
        """The waypoint in a motion of num_frames frames. A time just before the end counts as the last frame."""
        frame = min(rig.frames_in(self.at_s), num_frames - 1)
        return Waypoint(frame, self.x_m, self.z_m, self.heading_rad)


def parse_seconds(text: str) -> float:
    """A time from the start, seconds. Raises ArgumentTypeError, which argparse prints."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds) or seconds < 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number of seconds of 0 or more")
    return seconds


def parse_waypoint(text: str) -> TimedWaypoint:
    """Parse `x,z@seconds` or `x,z,heading@seconds`. Raises ArgumentTypeError, which argparse prints."""
    place, _, seconds = text.partition("@")
    try:
        numbers = [float(part) for part in place.split(",")]
        at_s = float(seconds)
    except ValueError:
        numbers, at_s = [], math.nan
    if len(numbers) not in (2, 3) or not all(map(math.isfinite, [*numbers, at_s])) or at_s < 0:
        raise argparse.ArgumentTypeError(
            f"{text!r} was given; allowed is x,z@seconds in metres, such as 0.5,4@3, or x,z,heading@seconds"
        )
    return TimedWaypoint(at_s, *numbers)


async def stream(options: argparse.Namespace) -> int:
    """Generate the motion, write the files, print a summary."""
    console = make_console()
    suffixes = {".bvh": True, ".npz": options.npz, ".png": options.png}
    for path in [options.out.with_suffix(suffix) for suffix, is_wanted in suffixes.items() if is_wanted]:
        check_file_to_write("--out", path)
    async with client_of(options, options.server) as client:
        catalog = client.catalog
        model = catalog.model(options.model) if options.model else catalog.models[0]
        rig = catalog.rig(model.rig_id)
        num_frames = max(1, rig.frames_in(options.seconds))
        waypoints = [waypoint.in_frames(rig, num_frames) for waypoint in options.waypoint]
        prompts = options.script.in_frames(rig, num_frames)
        session = await client.open(
            prompts.get(0),
            later_prompts={frame: text for frame, text in prompts.items() if frame > 0},
            options=SessionOptions(model_id=model.model_id, seed=options.seed, denoise_steps=options.steps),
            constraints=waypoints,
            keep_s=None,
        )
        with make_progress(console) as progress:
            bar = progress.add_task("generating", total=options.seconds, state="")
            async for frame in session.frames(num_frames / rig.frame_rate_hz, realtime=options.realtime):
                done_s = frame.time_s + 1 / rig.frame_rate_hz
                progress.update(bar, completed=done_s, state=f"{done_s:.1f} of {options.seconds:g} s")
        await session.close()
    motion = session.motion()
    title = "; then ".join(prompts[frame] for frame in sorted(prompts)) or "no prompt"
    notes = [(frame, text) for frame, text in prompts.items() if frame > 0]
    for path in write_files(options.out, Panel(title, motion, waypoints, notes), npz=options.npz, png=options.png):
        console.print(f"wrote {path}", soft_wrap=True)
    report = make_table("", "measured", "value")
    for name, value in measurements(session, motion, waypoints):
        report.add_row(name, value)
    console.print(report)
    console.print(f"The weights of {model.model_id} are licensed {model.licence}.", soft_wrap=True)
    return 0


def write_files(out: Path, panel: Panel, *, npz: bool, png: bool) -> list[Path]:
    """Write the BVH file and those that are wanted beside it. Returns the files."""
    out.parent.mkdir(parents=True, exist_ok=True)
    written = [out]
    write_bvh(out, panel.motion)
    if npz:
        written.append(out.with_suffix(".npz"))
        write_npz(written[-1], panel.motion)
    if png:
        written.append(out.with_suffix(".png"))
        write_picture(written[-1], [panel])
    return written


def measurements(session: Session, motion: Motion, waypoints: list[Waypoint]) -> list[tuple[str, str]]:
    """What was asked for and what resulted, as names and values to print."""
    stats = session.stats
    lines = [
        ("motion", f"{len(motion)} frames, {motion.duration_s:.2f} s"),
        ("seed", str(session.opened.seed)),
        ("time to first frame", f"{1000 * (stats.first_frame_s or math.nan):.0f} ms"),
        ("windows", str(stats.plans)),
        ("underruns", str(stats.underruns)),
    ]
    for waypoint in waypoints:
        place = f"waypoint {waypoint.x_m:g}, {waypoint.z_m:g} at frame {waypoint.frame}"
        lines.append((place, f"missed by {100 * waypoint_error_m(motion, waypoint):.1f} cm"))
    return lines


def waypoint_error_m(motion: Motion, waypoint: Waypoint) -> float:
    """Distance over the ground between the root and a waypoint, metres."""
    root = motion.frame(waypoint.frame).root_translation_m
    return float(np.hypot(root[0] - waypoint.x_m, root[2] - waypoint.z_m))
