"""Measures a running server: loads of `motiongen bench`, and windows as fast as they can be made."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from dataclasses import dataclass

from motiongen_client import MotionClient, Priority, Session, SessionOptions
from motiongen_tools.bench.load import Load, Progress
from motiongen_tools.bench.recorder import EVENT, OPEN
from motiongen_tools.bench.result import Result, Standard
from motiongen_tools.bench.run import run_load
from motiongen_tools.bench.scenario import EditRule, Group, Life, Scenario, load_scenario
from motiongen_tools.bench.search import find_most
from tests.bench.counting import counted
from tests.bench.prompts import PROMPTS

EDIT_EVERY_S = 0.53  # over all characters; not a multiple of the frame time or the flush interval
REST_S = 3.0


@dataclass(frozen=True)
class Effort:
    """Seconds of each part: opens, edits, counting windows, a trial of the search, the run that confirms it."""

    opens_s: int = 30
    edits_s: int = 15
    window_s: float = 10.0
    trial_s: int = 10
    confirm_s: int = 20


QUICK = Effort(opens_s=8, edits_s=4, window_s=3.0, trial_s=4, confirm_s=6)


@dataclass(frozen=True)
class Latencies:
    """Milliseconds. is_void: the load was late itself in every attempt, so that they do not count."""

    p50: float
    p95: float
    p99: float
    is_void: bool


@dataclass(frozen=True)
class Most:
    """The number of characters served in full. or_more: with more, the load was late itself."""

    characters: int
    or_more: bool

    def __str__(self) -> str:
        return f"{self.characters} or more" if self.or_more else f"{self.characters}"


async def open_latencies_ms(address: str, steps: int, seconds: int) -> Latencies:
    """From the scheduled open to the first frame, for characters that come and go one by one."""
    group = Group("guests", 1.0, Priority.NEAR, PROMPTS, life=Life(median_s=1.0, sigma=0.1))
    return _latencies_ms(await _play(address, steps, group, 1, seconds), OPEN)


async def edit_latencies_ms(address: str, steps: int, characters: int, seconds: int) -> Latencies:
    """From a new prompt to its first changed frame, with edits spread over characters that all play."""
    group = Group("players", 1.0, Priority.NEAR, PROMPTS, (EditRule("prompt", characters * EDIT_EVERY_S),))
    return _latencies_ms(await _play(address, steps, group, characters, seconds), EVENT)


async def most_served(address: str, steps: int, effort: Effort, say: Callable[[str], None]) -> Most:
    """The most characters of the scenario `crowd` that are served in full."""

    async def run(load: Load) -> Result:
        say(f"{load.characters} characters in real time")
        return await run_load(load, _ignore, Standard())

    load = Load(address, load_scenario("crowd"), 8, effort.confirm_s, seed=1, denoise_steps=steps)
    found = await find_most(load, run, effort.trial_s, lambda _: None, lambda: asyncio.sleep(REST_S))
    return Most(found.characters, found.limited_by_generator)


async def windows_per_s(client: MotionClient, steps: int, characters: int, seconds: float) -> float:
    """Windows of 40 frames per second, with clients that take frames as fast as they come."""

    async def take_all(session: Session) -> None:
        async for _ in session.frames(realtime=False):
            pass

    def num_windows() -> int:
        return sum(session.stats.plans for session in sessions)

    async with client.stream() as stream:
        opening = [
            stream.open(
                PROMPTS[seed % len(PROMPTS)],
                options=SessionOptions(seed=seed, denoise_steps=steps, lookahead_frames=80),
                keep_s=1.0,
            )
            for seed in range(characters)
        ]
        sessions = await asyncio.gather(*opening)
        taking = [asyncio.create_task(take_all(session)) for session in sessions]
        await asyncio.sleep(1.0)
        before, started_s = num_windows(), time.perf_counter()
        await asyncio.sleep(seconds)
        rate = (num_windows() - before) / (time.perf_counter() - started_s)
        for task in taking:
            task.cancel()
        await asyncio.gather(*taking, return_exceptions=True)
    return rate


async def _play(address: str, steps: int, group: Group, characters: int, seconds: int) -> Result:
    scenario = Scenario("figures", 1, "what the table needs", characters, 500, 0.0, 2.0, 2.0, 4.0, (group,), "")
    load = Load(address, scenario, characters, seconds, 1, steps)
    return await counted(lambda: run_load(load, _ignore, Standard()))


def _latencies_ms(result: Result, what: str) -> Latencies:
    """Raises RuntimeError if nothing was measured."""
    found = result.latency_ms(what)
    if not found["count"]:
        raise RuntimeError(f"{what} was asked for, but none was measured")
    return Latencies(found["p50"], found["p95"], found["p99"], bool(result.void_reasons()))


def _ignore(progress: Progress) -> None:
    """Discard progress reports."""
