"""Repeating void runs: a run counts only if its load generator was not late itself."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from motiongen_tools.bench.bracket import Bracket
from motiongen_tools.bench.result import Result

TRIES_WHEN_VOID = 3
"""Like `motiongen bench --find`: other work on the machine may have made the load late."""


async def counted(play: Callable[[], Awaitable[Result]]) -> Result:
    """The first result that counts. After TRIES_WHEN_VOID tries, the last one, although it is void (`void_reasons`)."""
    for _ in range(TRIES_WHEN_VOID):
        result = await play()
        if not result.void_reasons():
            break
    return result


async def most_passing(
    bracket: Bracket, play: Callable[[int], Awaitable[Result]], passes: Callable[[Result], bool]
) -> tuple[int, bool]:
    """The most characters that pass, and whether more might: every run with a larger number was void."""
    void = {}
    while (characters := bracket.next()) is not None:
        result = await counted(lambda so_many=characters: play(so_many))  # type: ignore[misc]
        void[characters] = bool(result.void_reasons())
        bracket.note(characters, not void[characters] and passes(result))
    return bracket.most, bracket.too_many is not None and void[bracket.too_many]
