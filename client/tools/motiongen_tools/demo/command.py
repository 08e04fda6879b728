"""`motiongen demo`: start a server, play the script, write the results, report problems."""

from __future__ import annotations

import argparse
import asyncio
import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motiongen_client.client import MotionClient
from motiongen_client.errors import MissingExtra, MotiongenError
from motiongen_tools.arguments import check_folder_to_write
from motiongen_tools.bvh import write_bvh
from motiongen_tools.connection import PLAIN, connection_of
from motiongen_tools.console import make_console, make_progress, starting
from motiongen_tools.demo.play import Take, close, open_cast, play
from motiongen_tools.demo.report import missed_places, print_report
from motiongen_tools.demo.script import CAST
from motiongen_tools.demo.sheet import Scene, write_scenes, write_story
from motiongen_tools.server_process import ServerFailed, ServerProcess

if TYPE_CHECKING:
    from rich.console import Console


async def demo(options: argparse.Namespace) -> int:
    """Run the demo. Returns 0 if all frames came, all waypoints were reached and the server exited cleanly, else 1."""
    console = make_console()
    check_folder_to_write("--out", options.out)
    with contextlib.ExitStack() as stack:
        address, problems, connection = options.server, [], connection_of(options)
        if address is None:
            with starting(console, "starting the server with the built-in model") as tell:
                # At this speed, the load monitor would take the cast for a crowd and give it fewer steps. Nothing is
                # shown in real time, so a slow machine only takes longer.
                settings = ["--degrade", "false", "--admit-load", "1000", "--playback-rate", "1000"]
                own = ServerProcess(settings, ready_timeout_s=options.start_timeout, tell=tell)
                server = stack.enter_context(own)
            console.print(f"server ready on {server.address} after {server.ready_s:.1f} s (process {server.pid})")
            address, connection = server.address, PLAIN
        try:
            takes = await perform(connection.client(address), options.seconds, console)
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
    print_report(takes, options.bound, console)
    for take in takes:
        problem = take.problem(take.session.rig.frames_in(options.seconds))
        found = [problem] if problem else missed_places(take, options.bound)
        problems += [f"{take.role.name}: {each}" for each in found]
    for problem in problems:
        console.print(f"problem: {problem}", style="red", soft_wrap=True)
    return 1 if problems else 0


async def perform(client: MotionClient, seconds: float, console: Console) -> list[Take]:
    """Play the cast on one stream for `seconds` of motion. client: not connected yet."""
    async with client:
        model = client.catalog.models[0]
        console.print(
            f"{model.model_id} on {model.rig_id}, {model.default_denoise_steps} denoising steps, weights licensed "
            f"{model.licence}; {len(CAST)} characters on one stream, {seconds:g} s of motion each",
            soft_wrap=True,
        )
        async with client.stream() as stream:
            takes = await open_cast(stream, CAST)
            showing = asyncio.create_task(show_progress(takes, seconds, console))
            await asyncio.gather(*(play(take, stream, seconds) for take in takes))
            showing.cancel()
            await asyncio.gather(showing, *(close(take) for take in takes), return_exceptions=True)
    return takes


async def show_progress(takes: Sequence[Take], seconds: float, console: Console) -> None:
    """Show a bar with the frames taken and the windows received, until cancelled."""
    expected = sum(take.session.rig.frames_in(seconds) for take in takes)
    with make_progress(console) as progress:
        bar = progress.add_task("playing", total=expected, state="")
        while True:
            taken = sum(max(take.session.playback.playhead, 0) for take in takes)
            windows = sum(take.session.stats.plans for take in takes)
            progress.update(bar, completed=taken, state=f"{taken} frames of {windows} windows")
            await asyncio.sleep(0.1)


def write_results(takes: Sequence[Take], out: Path, console: Console) -> None:
    """Write a BVH file for each character that moved, and the contact sheets."""
    out.mkdir(parents=True, exist_ok=True)
    scenes = []
    for number, take in enumerate(takes, 1):
        motion = take.motion()
        if motion is None or not np.isfinite(motion.rows).all():
            continue
        write_bvh(out / f"{number}-{take.role.name}.bvh", motion)
        scenes.append(Scene(f"{number}  {take.role.name}", motion, take.prompts, take.goals))
    if not scenes:
        return
    console.print(f"wrote {len(scenes)} BVH files to {out}", soft_wrap=True)
    try:
        write_story(out / "contact_sheet.png", scenes[0])
        console.print(f"wrote {out / 'contact_sheet.png'}", soft_wrap=True)
        if len(scenes) > 1:
            write_scenes(out / "contact_sheet_beside.png", scenes[1:])
            console.print(f"wrote {out / 'contact_sheet_beside.png'}", soft_wrap=True)
    except MissingExtra as error:
        console.print(f"no picture: {error}", soft_wrap=True)
