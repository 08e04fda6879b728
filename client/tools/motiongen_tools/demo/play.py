"""Playing the script: all characters on one stream, as fast as the server makes them.

Frames are taken without waiting for their time. So that what is asked at a time of the motion shows right after it,
whatever the speed, a character that has come to a cue tells the server where it is and takes no frame until the server
has answered.
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

_REPORT_S = 0.06  # a report of the playhead has gone out by then
_ANSWER_S = 3.0  # an edit that is answered later shows later; its frames tell
_SLOWEST = 3.0  # times real time that a performance may take


@dataclass
class Take:
    """One character's performance. prompts: what it was told, by the frame from which it shows."""

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
        """What the server took, but does not promise."""
        outcomes = [edit.outcome for edit in self.edits]
        return [*self.session.opened.warnings, *(each for given in outcomes if given for each in given.warnings)]

    def motion(self) -> Motion | None:
        """What was shown; None when nothing was."""
        return self.session.motion() if self.session.playback.started else None

    def problem(self, num_expected: int) -> str:
        """Why this is not what was asked for, its goals aside; empty when it is."""
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
    """A session for each role; the seeds are fixed, and so is what comes of the same weights."""
    options = [SessionOptions(seed=seed) for seed in range(len(cast))]
    opening = [stream.open(role.prompt, options=own, keep_s=None) for role, own in zip(cast, options, strict=True)]
    sessions = await asyncio.gather(*opening)
    return [Take(role, session, prompts=[(0, role.prompt)]) for role, session in zip(cast, sessions, strict=True)]


async def play(take: Take, stream: Stream, seconds: float) -> None:
    """Play one character through its cues; what went wrong is left in `take.failure`."""
    session, cues, limit_s = take.session, list(take.role.cues), _SLOWEST * seconds + 10
    began_s = time.monotonic()
    try:
        async with asyncio.timeout(limit_s):
            async for frame in session.frames(seconds, realtime=False):
                while cues and frame.time_s >= cues[0].at_s:
                    await _give(take, stream, cues.pop(0).actions)
        for edit in take.edits:
            if edit.done():
                await edit  # a refusal is raised here
    except TimeoutError:
        take.failure = f"only {len(session.motion()) if session.playback.started else 0} frames in {limit_s:g} s"
    except MotiongenError as error:
        take.failure = str(error)
    take.wall_s = time.monotonic() - began_s


async def _give(take: Take, stream: Stream, actions: Iterable[Action]) -> None:
    """Ask for the actions of a cue together, and wait for the answers."""
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
    """Until the answer to an edit has come, whatever it is."""
    with contextlib.suppress(MotiongenError):  # `play` raises it when it has shown what there is
        await edit


async def close(take: Take) -> None:
    """End a session, unless it has failed already."""
    if not take.failure:
        await take.session.close()
