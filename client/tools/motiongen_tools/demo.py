"""`motiongen demo`: eight characters on one stream, in real time, from a server of its own."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motiongen_client.client import MotionClient
from motiongen_client.edit import Edit
from motiongen_client.errors import MissingExtra, MotiongenError
from motiongen_client.kinematics import heading_rad, quaternion_to_matrix
from motiongen_client.motion import Motion
from motiongen_client.session import Session
from motiongen_client.types import SessionOptions, Waypoint
from motiongen_tools.bvh import write_bvh
from motiongen_tools.cli_stream import waypoint_error_m
from motiongen_tools.console import make_console, make_progress, make_table
from motiongen_tools.picture import Panel, write_picture
from motiongen_tools.server_process import ServerFailed, ServerProcess

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True)
class Role:
    """What a character is asked to do. then: the prompt that replaces the first one half way. goes_to: a waypoint."""

    name: str
    prompt: str
    then: str = ""
    goes_to: bool = False


CAST = (
    Role("walk", "a person walks forward", goes_to=True),
    Role("run", "a person runs forward"),
    Role("wave-right", "a person waves with the right hand"),
    Role("wave-both", "a person waves with both hands"),
    Role("raise-left", "a person raises the left hand"),
    Role("turn-left", "a person walks and turns left"),
    Role("stand", "a person stands still", then="a person walks forward"),
    Role("elderly", "an elderly person walks forward"),
)

# The waypoint lies this far to the left of where the walker would be this much later.
_LEFT_M, _LATER_S = 0.5, 2.5


@dataclass
class Take:
    """One character's performance."""

    role: Role
    session: Session
    edits: list[Edit] = field(default_factory=list)
    waypoints: list[Waypoint] = field(default_factory=list)
    notes: list[tuple[int, str]] = field(default_factory=list)
    failure: str = ""

    def motion(self) -> Motion | None:
        """What was shown; None when nothing was."""
        return self.session.motion() if self.session.playback.started else None

    def problem(self, num_expected: int) -> str:
        """Why this is not what was asked for; empty when it is."""
        motion = self.motion()
        if self.failure:
            return self.failure
        if motion is None:
            return "no frame came"
        if not np.isfinite(motion.rows).all():
            return "frames hold numbers that are not finite"
        if len(motion) < num_expected:
            return f"{len(motion)} of {num_expected} frames came"
        if np.ptp(motion.rows, axis=0).max() == 0:
            return "the character never moved"
        return ""

    def waypoint_errors_m(self) -> list[float]:
        motion = self.motion()
        return [] if motion is None else [waypoint_error_m(motion, waypoint) for waypoint in self.waypoints]


async def demo(options: argparse.Namespace) -> int:
    """Run it all. Returns 0 if every character moved and the server behaved, else 1."""
    console = make_console()
    with contextlib.ExitStack() as stack:
        address, problems = options.server, []
        if address is None:
            with console.status("starting the server with the built-in model"):
                server = stack.enter_context(ServerProcess())
            console.print(f"server ready on {server.address} after {server.ready_s:.1f} s (process {server.pid})")
            address = server.address
        try:
            takes = await perform(address, options.seconds, console)
        except MotiongenError as error:
            if options.server is None:
                raise ServerFailed(str(error), server.log_tail()) from error
            raise
        if options.server is None:
            try:
                server.stop()
                console.print("server stopped by SIGTERM, exit code 0")
            except ServerFailed as failure:
                problems.append(str(failure))
    write_results(takes, options.out, console)
    print_report(takes, console)
    num_expected = num_frames(takes[0], options.seconds)
    problems += [f"{take.role.name}: {problem}" for take in takes if (problem := take.problem(num_expected))]
    for problem in problems:
        console.print(f"[red]problem:[/red] {problem}", soft_wrap=True)
    return 1 if problems else 0


def num_frames(take: Take, seconds: float) -> int:
    """Frames of a performance without underruns, less one in ten: holding a pose now and then is no failure."""
    return math.floor(0.9 * take.session.rig.frames_in(seconds))


async def perform(address: str, seconds: float, console: Console) -> list[Take]:
    """Drive the cast on one stream for `seconds` in real time."""
    async with MotionClient(address) as client:
        model = client.catalog.models[0]
        console.print(
            f"{model.model_id} on {model.rig_id}, {model.default_denoise_steps} denoising steps, weights licensed "
            f"{model.licence}; {len(CAST)} characters on one stream for {seconds:g} s",
            soft_wrap=True,
        )
        async with client.stream() as stream:
            opening = [
                stream.open(role.prompt, options=SessionOptions(seed=seed), keep_s=None)
                for seed, role in enumerate(CAST)
            ]
            sessions = await asyncio.gather(*opening)
            takes = [Take(role, session) for role, session in zip(CAST, sessions, strict=True)]
            showing = asyncio.create_task(show_progress(takes, seconds, console))
            await asyncio.gather(*(play(take, seconds) for take in takes))
            showing.cancel()
            await asyncio.gather(showing, *(close(take) for take in takes), return_exceptions=True)
    return takes


async def play(take: Take, seconds: float) -> None:
    """Play one character, changing its prompt half way and giving it a waypoint at a quarter, if its role says so."""
    half, quarter = seconds / 2, seconds / 4
    session, role = take.session, take.role
    try:
        async with asyncio.timeout(seconds + 5):
            async for frame in session.frames(seconds):
                if role.then and not take.notes and frame.time_s >= half:
                    take.edits.append(session.set_prompt(role.then))
                    take.notes.append((frame.index, role.then))
                if role.goes_to and not take.waypoints and frame.time_s >= quarter:
                    waypoint = waypoint_ahead(session.motion(), min(_LATER_S, half))
                    take.waypoints.append(waypoint)
                    take.edits.append(session.add_constraints([waypoint]))
        for edit in take.edits:
            if edit.done():
                await edit
    except TimeoutError:
        take.failure = f"only {len(session.motion()) if session.playback.started else 0} frames in {seconds + 5:g} s"
    except MotiongenError as error:
        take.failure = str(error)


def waypoint_ahead(motion: Motion, seconds: float) -> Waypoint:
    """Where a character would be after `seconds` if it went on as in its last second, and half a metre to the left."""
    rig, root = motion.rig, motion.root_translation_m[:, [0, 2]].astype(np.float64)
    since = min(rig.frame_rate_hz, len(root) - 1)
    velocity = (root[-1] - root[-1 - since]) * rig.frame_rate_hz / max(since, 1)  # metres a second
    facing = float(heading_rad(quaternion_to_matrix(motion.joint_rotation_quat_wxyz[-1, 0])))
    x, z = root[-1] + velocity * seconds + _LEFT_M * np.array([math.cos(facing), -math.sin(facing)])
    return Waypoint(motion.first_frame + len(root) - 1 + rig.frames_in(seconds), float(x), float(z))


async def close(take: Take) -> None:
    """End a session, unless it has failed already."""
    if not take.failure:
        await take.session.close()


async def show_progress(takes: Sequence[Take], seconds: float, console: Console) -> None:
    """A bar with the time, the windows and the underruns, until cancelled."""
    started_s = time.monotonic()
    with make_progress(console) as progress:
        bar = progress.add_task("playing", total=seconds, state="")
        while True:
            stats = [take.session.stats for take in takes]
            windows, underruns = sum(each.plans for each in stats), sum(each.underruns for each in stats)
            state = f"{windows} windows, {underruns} underruns"
            progress.update(bar, completed=min(time.monotonic() - started_s, seconds), state=state)
            await asyncio.sleep(0.1)


def write_results(takes: Sequence[Take], out: Path, console: Console) -> None:
    """A BVH file for each character that moved, and the contact sheet."""
    out.mkdir(parents=True, exist_ok=True)
    panels = []
    for number, take in enumerate(takes, 1):
        motion = take.motion()
        if motion is None or not np.isfinite(motion.rows).all():
            continue
        write_bvh(out / f"{number}-{take.role.name}.bvh", motion)
        panels.append(Panel(f"{number}  {take.role.prompt}", motion, take.waypoints, take.notes))
    if not panels:
        return
    console.print(f"wrote {len(panels)} BVH files to {out}", soft_wrap=True)
    try:
        write_picture(out / "contact_sheet.png", panels)
        console.print(f"wrote {out / 'contact_sheet.png'}", soft_wrap=True)
    except MissingExtra as error:
        console.print(f"no picture: {error}", soft_wrap=True)


def print_report(takes: Sequence[Take], console: Console) -> None:
    """One line a character, and the figures of all of them."""
    columns = ("first frame", "windows", "underruns", "path", "edit to frame", "waypoint")
    table = make_table("", "character", *columns)
    first_frames, latencies = [], []
    for take in takes:
        stats, motion = take.session.stats, take.motion()
        own = [edit.latency_s for edit in take.edits if edit.latency_s is not None]
        latencies += own
        if stats.first_frame_s is not None:
            first_frames.append(stats.first_frame_s)
        table.add_row(
            take.role.name,
            milliseconds([stats.first_frame_s] if stats.first_frame_s is not None else []),
            str(stats.plans),
            str(stats.underruns),
            "-" if motion is None else f"{travelled_m(motion):.1f} m",
            milliseconds(own),
            ", ".join(f"{100 * error:.0f} cm off" for error in take.waypoint_errors_m()) or "-",
        )
    console.print(table)
    late = sum(take.session.stats.late_plans for take in takes)
    console.print(
        f"time to first frame {milliseconds(first_frames)} (p50), {milliseconds(first_frames, 95)} (p95); "
        f"event to first changed frame {milliseconds(latencies)} (p50), {milliseconds(latencies, 95)} (p95) "
        f"of {len(latencies)} events; plans that came too late for the playhead: {late}",
        soft_wrap=True,
    )


def milliseconds(seconds: Sequence[float], percentile: float = 50) -> str:
    """A percentile in milliseconds; a dash when there is nothing to take it of."""
    return f"{1000 * float(np.percentile(seconds, percentile)):.0f} ms" if seconds else "-"


def travelled_m(motion: Motion) -> float:
    """Length of the root's path over the ground, metres."""
    steps = np.diff(motion.root_translation_m[:, [0, 2]], axis=0)
    return float(np.linalg.norm(steps, axis=1).sum())
