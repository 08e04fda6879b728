"""Finds the most characters that a server serves in full: doubling, bisection, and a longer run to confirm."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from motiongen_client.errors import MotiongenError
from motiongen_tools.bench.bracket import Bracket
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.recorder import EVENT
from motiongen_tools.bench.result import Result

_TRIES_WHEN_VOID = 3  # another process on the machine may have made the load late


@dataclass(frozen=True)
class Trial:
    """One run of a search. shortfalls: empty if all were served in full; void: why its figures do not count."""

    characters: int
    seconds: int
    miss_ratio: float
    event_p99_ms: float | None
    shortfalls: tuple[str, ...]
    void: tuple[str, ...]

    @property
    def passed(self) -> bool:
        return not self.shortfalls and not self.void


@dataclass(frozen=True)
class Found:
    """The result of a search. result: the confirming run of `characters`; None if not even one was served.

    limited_by_generator: the run with more was void, so the server may be able to serve more. out_of_time: the time
    ended before the search was as precise as usual, or before its answer was confirmed. failure: why a run after the
    first could not be made, such as a server that is gone; "" if all could.
    """

    characters: int
    result: Result | None
    trials: tuple[Trial, ...]
    limited_by_generator: bool
    out_of_time: bool = False
    failure: str = ""


async def find_most(
    load: Load,
    run: Callable[[Load], Awaitable[Result]],
    trial_seconds: int,
    note: Callable[[Trial], None],
    rest: Callable[[], Awaitable[None]],
    *,
    within_s: float = math.inf,
    clock: Callable[[], float] = time.monotonic,
) -> Found:
    """Start with load.characters. Trials measure for trial_seconds, the confirming run for load.seconds.

    note: called after each trial. rest: lets the server recover from a trial that overloaded it. within_s: no trial
    starts that would not leave enough of this time, on the clock, for the confirming run. Raises what the first run
    raises; the failure of a later one ends the search.
    """
    bracket = Bracket(load.characters)
    trials: list[Trial] = []
    began_at, beside_s = clock(), 0.0  # beside_s: greatest time so far that a run took beyond its measuring

    def is_time_for(*seconds: int) -> bool:
        return clock() - began_at + sum(seconds) + len(seconds) * beside_s <= within_s

    async def attempt(characters: int, seconds: int) -> Result:
        nonlocal beside_s
        for _ in range(_TRIES_WHEN_VOID):
            begun_at = clock()
            result = await run(replace(load, characters=characters, seconds=seconds))
            trials.append(judge(result))
            note(trials[-1])
            if not trials[-1].passed:
                await rest()
            beside_s = max(beside_s, clock() - begun_at - seconds)
            if not trials[-1].void or not is_time_for(seconds, load.seconds):
                break
        bracket.note(characters, trials[-1].passed)
        return result

    confirmed: Result | None = None
    out_of_time, failure = False, ""
    try:
        while confirmed is None:
            while (characters := bracket.next()) is not None:
                out_of_time = bool(trials) and not is_time_for(trial_seconds, load.seconds)
                if out_of_time:
                    break
                await attempt(characters, trial_seconds)
            if bracket.most == 0 or (out_of_time and not is_time_for(load.seconds)):
                break
            result = await attempt(bracket.most, load.seconds)
            if trials[-1].passed:
                confirmed = result
    except MotiongenError as error:
        if not trials:
            raise
        failure = str(error)  # the trials so far may have taken hours
    last = {trial.characters: trial for trial in trials}
    limited = bracket.too_many in last and bool(last[bracket.too_many].void)
    return Found(bracket.most, confirmed, tuple(trials), limited, out_of_time, failure)


def judge(result: Result) -> Trial:
    event = result.latency_ms(EVENT)
    return Trial(
        result.load.characters,
        result.load.seconds,
        result.figures().miss_ratio,
        event.get("p99"),
        tuple(result.shortfalls()),
        tuple(result.void_reasons()),
    )
