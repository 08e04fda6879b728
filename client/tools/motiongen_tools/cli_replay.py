"""`motiongen replay`: play a session file of the viewer again, in real time, and write the motion to files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from motiongen_client.edit import Edit
from motiongen_client.errors import EventRefused, MotiongenError
from motiongen_client.motion import Motion
from motiongen_client.session import Session
from motiongen_client.types import StartPose
from motiongen_tools.arguments import check_file_to_write
from motiongen_tools.cli_generate import write_motion
from motiongen_tools.connection import client_of
from motiongen_tools.console import make_console
from motiongen_tools.npz import write_npz
from motiongen_tools.out_files import motion_path
from motiongen_tools.view.commands import apply, read_prompt
from motiongen_tools.view.rehearsal import Rehearsal, ToldAt
from motiongen_tools.view.room import session_options
from motiongen_tools.view.session_file import SessionFile, naming, read_session


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command, except those that choose the server."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a session file, as the viewer saves it")
    parser.add_argument(
        "--out", type=motion_path, action="append", metavar="FILE", help="can be repeated (default: replay.npz)"
    )


async def replay(options: argparse.Namespace) -> int:
    """Play the file, write the motion, and list the edits that took effect at another frame than when recorded."""
    session_file = read_session(options.file)
    console = make_console()
    outs = options.out or [Path("replay.npz")]
    for path in outs:
        check_file_to_write("--out", path)
    opening = session_file.opening
    with naming(f"{options.file}, opening"):
        prompt = read_prompt(opening) if opening.get("text") or opening.get("preset") else None
        asked = session_options(opening, StartPose())
    async with client_of(options, options.server) as client:
        session = await client.open(prompt, options=asked, keep_s=None)
        waited_s = session_file.num_frames / session.rig.frame_rate_hz
        with console.status(f"playing {waited_s:.0f} s"), naming(str(options.file)):
            answers = await play(session, session_file)
        motion = session.motion(0, session_file.num_frames)
        await session.close()
    failures: list[Exception] = []
    for path in outs:
        try:
            lines = _write(path, motion)
        except (MotiongenError, OSError) as failure:  # playing took long: still write the other files
            failures.append(failure)
        else:
            console.print("\n".join([f"wrote {path}", *lines]), soft_wrap=True)
    others = [f"{edit.message['op']} at frame {edit.at_frame}: {said}" for edit, said in answers if said]
    as_recorded = len(answers) - len(others)
    console.print(f"edits that took effect as recorded: {as_recorded} of {len(answers)}", soft_wrap=True)
    for line in others:
        console.print(f"  {line}", soft_wrap=True)
    for one in failures:
        print(f"error: {one}", file=sys.stderr)
    return 1 if failures else 0


async def play(session: Session, session_file: SessionFile) -> list[tuple[ToldAt, str]]:
    """Send each edit of the file at its frame. Returns each edit with how its outcome differs, "" if it does not.

    Raises InvalidInput for an edit that no server could accept, and the error that ended the session.
    """
    rehearsal = Rehearsal(session_file.edits, session_file.num_frames)
    sent: list[tuple[ToldAt, Edit]] = []
    seconds = session_file.num_frames / session.rig.frame_rate_hz
    async for frame in session.frames(seconds=seconds):
        for then in rehearsal.due(frame.index):
            with naming(f"edit at frame {then.at_frame}"):
                edit = apply(session, rehearsal.renumbered(then.message))
            rehearsal.told(then, edit)
            sent.append((then, edit))
    told = [(edit, await _difference(edit, answer)) for edit, answer in sent]
    return told + [(edit, "not sent: the motion ended before it") for edit in rehearsal.left]


async def _difference(edit: ToldAt, answer: Edit) -> str:
    if not answer.done():
        return "not answered before the end"
    try:
        outcome = await answer
    except EventRefused as refusal:
        return str(refusal)
    if outcome.effective_frame == edit.effective_frame:
        return ""
    recorded = "without one" if edit.effective_frame is None else f"from frame {edit.effective_frame}"
    return f"from frame {outcome.effective_frame} on, recorded {recorded}"


def _write(path: Path, motion: Motion) -> list[str]:
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npz":
        write_npz(path, motion)
        return []
    return write_motion(path, motion, "", None)
