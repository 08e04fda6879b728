"""The measurements, each against a running server, from one client process with one event loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass

from motiongen_client import MotionClient, Session, SessionOptions, Stream

PROMPTS = (
    "a person walks forward",
    "a person runs forward",
    "a person waves with the right hand",
    "a person walks and turns left",
    "a person stands still",
)
POLL_HZ = 40


@dataclass(frozen=True)
class Effort:
    """How long and how often to measure.

    opens, edits: how many are timed. window_s: seconds of counting windows. trial_s: seconds of playing in one trial of
    the search; most: characters at which the search stops.
    """

    opens: int = 20
    edits: int = 24
    window_s: float = 10.0
    trial_s: float = 15.0
    most: int = 200


QUICK = Effort(opens=5, edits=6, window_s=3.0, trial_s=4.0, most=64)


def options(seed: int, steps: int, lookahead_frames: int | None = None) -> SessionOptions:
    return SessionOptions(seed=seed, denoise_steps=steps, lookahead_frames=lookahead_frames)


async def open_latencies(client: MotionClient, steps: int, count: int) -> list[float]:
    """Seconds from the call of open to the first frame, one session after another on an idle server."""
    seconds = []
    async with client.stream() as stream:
        for seed in range(count):
            async with await stream.open(PROMPTS[seed % len(PROMPTS)], options=options(seed, steps)) as session:
                async for _ in session.frames(0.1, realtime=False):
                    pass
                if session.stats.first_frame_s is not None:
                    seconds.append(session.stats.first_frame_s)
    return seconds


async def edit_latencies(client: MotionClient, steps: int, count: int, characters: int) -> list[float]:
    """Seconds from a prompt's change to its first changed frame, changes spread over `characters` that all play."""
    async with client.stream() as stream:
        sessions = await open_all(stream, steps, characters)
        edits = []
        async with playing(sessions):
            await asyncio.sleep(2.0)
            for number in range(count):
                prompt = PROMPTS[(number // characters + number + 1) % len(PROMPTS)]
                edits.append(sessions[number % characters].set_prompt(prompt))
                await asyncio.sleep(0.53)  # not a multiple of the frame time or the flush interval
            await asyncio.sleep(1.0)
    return [edit.latency_s for edit in edits if edit.latency_s is not None]


async def windows_per_s(client: MotionClient, steps: int, characters: int, seconds: float) -> float:
    """Windows of 40 frames a second when frames are taken as fast as they come."""
    async with client.stream() as stream:
        sessions = await open_all(stream, steps, characters, lookahead_frames=80)
        taking = [asyncio.create_task(take_all(session)) for session in sessions]
        await asyncio.sleep(1.0)
        before, started_s = num_windows(sessions), time.perf_counter()
        await asyncio.sleep(seconds)
        rate = (num_windows(sessions) - before) / (time.perf_counter() - started_s)
        for task in taking:
            task.cancel()
        await asyncio.gather(*taking, return_exceptions=True)
    return rate


async def realtime_characters(
    client: MotionClient, steps: int, effort: Effort, say: Callable[[str], None]
) -> tuple[int, list[tuple[int, int]]]:
    """The most characters found to play in real time without one underrun, and (characters, underruns) of each trial.

    Doubles from 8 until one fails, then halves the gap until it is within a tenth.
    """
    trials: list[tuple[int, int]] = []

    async def passes(characters: int) -> bool:
        say(f"{characters} characters in real time")
        underruns = await count_underruns(client, steps, characters, effort.trial_s)
        trials.append((characters, underruns))
        return underruns == 0

    good, bad = await search(passes, start=8, most=effort.most)
    while bad - good > max(1, good // 10):
        middle = (good + bad) // 2
        good, bad = (middle, bad) if await passes(middle) else (good, middle)
    return good, trials


async def search(passes: Callable[[int], Awaitable[bool]], start: int, most: int) -> tuple[int, int]:
    """Double until it fails: the last that passed and the first that did not, or `most` twice."""
    good, tried = 0, start
    while await passes(tried):
        good = tried
        if good == most:
            return most, most
        tried = min(2 * tried, most)
    return good, tried


async def count_underruns(client: MotionClient, steps: int, characters: int, seconds: float) -> int:
    """Frame times held over all characters; a character that shows nothing counts every frame time."""
    async with client.stream() as stream:
        sessions = await open_all(stream, steps, characters)
        async with playing(sessions):
            await asyncio.sleep(seconds)
        silent = sum(not session.playback.started for session in sessions)
        held = sum(session.stats.underruns for session in sessions)
        return held + silent * sessions[0].rig.frames_in(seconds)


async def open_all(stream: Stream, steps: int, characters: int, lookahead_frames: int | None = None) -> list[Session]:
    opening = [
        stream.open(PROMPTS[seed % len(PROMPTS)], options=options(seed, steps, lookahead_frames), keep_s=1.0)
        for seed in range(characters)
    ]
    return list(await asyncio.gather(*opening))


class playing:
    """All sessions play in real time, moved by one loop as a game would."""

    def __init__(self, sessions: list[Session]) -> None:
        self._sessions = sessions

    async def __aenter__(self) -> None:
        self._task = asyncio.create_task(self._play())

    async def __aexit__(self, *_: object) -> None:
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)

    async def _play(self) -> None:
        while True:
            for session in self._sessions:
                session.poll()
            await asyncio.sleep(1 / POLL_HZ)


async def take_all(session: Session) -> None:
    async for _ in session.frames(realtime=False):
        pass


def num_windows(sessions: list[Session]) -> int:
    return sum(session.stats.plans for session in sessions)
