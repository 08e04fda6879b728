"""The most characters that a server serves in full, found by doubling, bisection, and a longer run to confirm."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, replace

from motiongen_tools.bench.bracket import Bracket
from motiongen_tools.bench.load import Load
from motiongen_tools.bench.recorder import EVENT
from motiongen_tools.bench.result import Result

_TRIES_WHEN_VOID = 3  # something else on the machine may have made the load late


@dataclass(frozen=True)
class Trial:
    """One run of a search. shortfalls: empty when all were served in full; void: when the figures do not count."""

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
    """What a search came to. result: the confirming run of `characters`; None when not one was served.

    limited_by_generator: a larger number was void, so the server may well serve more.
    """

    characters: int
    result: Result | None
    trials: tuple[Trial, ...]
    limited_by_generator: bool


async def find_most(
    load: Load,
    run: Callable[[Load], Awaitable[Result]],
    trial_seconds: int,
    note: Callable[[Trial], None],
    rest: Callable[[], Awaitable[None]],
) -> Found:
    """Start with load.characters. Trials measure trial_seconds, the run that confirms the answer load.seconds.

    note: called after each trial. rest: lets the server get over a trial that was too much for it.
    """
    bracket = Bracket(load.characters)
    trials: list[Trial] = []

    async def attempt(characters: int, seconds: int) -> Result:
        for _ in range(_TRIES_WHEN_VOID):
            result = await run(replace(load, characters=characters, seconds=seconds))
            trials.append(judge(result))
            note(trials[-1])
            if trials[-1].passed:
                break
            await rest()
            if not trials[-1].void:
                break
        bracket.note(characters, trials[-1].passed)
        return result

    confirmed: Result | None = None
    while confirmed is None:
        while (characters := bracket.next()) is not None:
            await attempt(characters, trial_seconds)
        if bracket.most == 0:
            break
        result = await attempt(bracket.most, load.seconds)
        if trials[-1].passed:
            confirmed = result
    last = {trial.characters: trial for trial in trials}
    limited = bracket.too_many in last and bool(last[bracket.too_many].void)
    return Found(bracket.most, confirmed, tuple(trials), limited)


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
