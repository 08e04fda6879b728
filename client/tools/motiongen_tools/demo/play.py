"""Plays the script: all characters on one stream, as fast as the server generates them.

Frames are taken without waiting for real time. When a character reaches a cue, it tells the server where it is and
takes no frame until the server has answered. So what the cue asks for shows right after it, whatever the speed.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from motiongen_client.edit import Edit
from motiongen_client.errors import MotiongenError
from motiongen_client.motion import Motion
from motiongen_client.session import Session
from motiongen_client.stream import Stream
from motiongen_client.types import ModelWarning, SessionOptions
from motiongen_tools.demo.direct import Asked, ask, here
from motiongen_tools.demo.goals import Goal
from motiongen_tools.demo.script import Action, Role, Say

_REPORT_S = 0.06  # by then, a report of the playhead has been sent
_ANSWER_S = 3.0  # an edit whose answer takes longer shows later, as its effective frame tells
_SLOWEST = 3.0  # longest that a performance may take, relative to real time


@dataclass
class Take:
    """One character's performance. prompts: the prompts it was given, by the frame from which each shows."""

    role: Role
    session: Session
    asked: list[Asked] = field(default_factory=list)
    prompts: list[tuple[int, str]] = field(default_factory=list)
    failure: str = ""
    wall_s: float = 0.0

    @property
    def goals(self) -> list[Goal]:
        return [goal for asked in self.asked for goal in asked.goals]

    @property
    def edits(self) -> list[Edit]:
        return [asked.edit for asked in self.asked]

    @property
    def warnings(self) -> list[ModelWarning]:
        """What the server accepted but does not promise."""
        outcomes = [edit.outcome for edit in self.edits]
        return [*self.session.opened.warnings, *(each for given in outcomes if given for each in given.warnings)]

    def motion(self) -> Motion | None:
        """The frames that were shown; None if there were none."""
        return self.session.motion() if self.session.playback.started else None

    def problem(self, num_expected: int) -> str:
        """What is wrong with the take, apart from its goals; empty if nothing is."""
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


async def open_cast(stream: Stream, cast: Sequence[Role]) -> list[Take]:
    """Open a session for each role. The seeds are fixed, so the same weights give the same motion."""
    options = [SessionOptions(seed=seed) for seed in range(len(cast))]
    opening = [stream.open(role.prompt, options=own, keep_s=None) for role, own in zip(cast, options, strict=True)]
    sessions = await asyncio.gather(*opening)
    return [Take(role, session, prompts=[(0, role.prompt)]) for role, session in zip(cast, sessions, strict=True)]


async def play(take: Take, stream: Stream, seconds: float) -> None:
    """Play one character through its cues. An error is stored in `take.failure`."""
    session, cues, limit_s = take.session, list(take.role.cues), _SLOWEST * seconds + 10
    began_s = time.monotonic()
    try:
        async with asyncio.timeout(limit_s):
            async for frame in session.frames(seconds, realtime=False):
                while cues and frame.time_s >= cues[0].at_s:
                    await _give(take, stream, cues.pop(0).actions)
        for edit in take.edits:
            if edit.done():
                await edit  # raises a refusal
    except TimeoutError:
        take.failure = f"only {len(session.motion()) if session.playback.started else 0} frames in {limit_s:g} s"
    except MotiongenError as error:
        take.failure = str(error)
    take.wall_s = time.monotonic() - began_s


async def _give(take: Take, stream: Stream, actions: Iterable[Action]) -> None:
    """Send the actions of a cue together, and wait for the answers."""
    stream.report_soon()
    await asyncio.sleep(_REPORT_S)
    at = here(take.session.motion())
    given = [asked for action in actions for asked in ask(take.session, action, at)]
    take.asked += given
    waiting = [asyncio.ensure_future(_answered(asked.edit)) for asked in given if asked.scheduled_frame is None]
    await asyncio.wait(waiting, timeout=_ANSWER_S)
    for asked in given:
        if isinstance(asked.action, Say):
            take.prompts.append((_first_frame(asked, at.frame), asked.action.text))


def _first_frame(asked: Asked, now_frame: int) -> int:
    if asked.scheduled_frame is not None:
        return asked.scheduled_frame
    outcome = asked.edit.outcome
    return now_frame if outcome is None or outcome.effective_frame is None else outcome.effective_frame


async def _answered(edit: Edit) -> None:
    """Wait for the answer to an edit, whatever it is."""
    with contextlib.suppress(MotiongenError):  # `play` raises it at the end
        await edit


async def close(take: Take) -> None:
    """Close a session, unless it has already failed."""
    if not take.failure:
        await take.session.close()
