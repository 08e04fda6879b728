"""Void runs of a load are repeated, and reported if none counts."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest

from motiongen_tools.bench.bracket import Bracket
from tests.bench import served
from tests.bench.counting import counted, most_passing
from tests.bench.service_cost import Latency, markdown


@dataclass
class Run:
    """A stand-in for a result."""

    characters: int = 0
    is_void: bool = False
    missed: float = 0.0

    def void_reasons(self) -> list[str]:
        return ["the generator was late"] * self.is_void

    def latency_ms(self, what: str) -> dict[str, float]:
        del what
        return {"count": 1.0, "p50": 1.0, "p95": 2.0, "p99": 3.0}


class Loads:
    """Gives void runs as often as void_times says, by the number of characters, before one that counts."""

    def __init__(self, void_times: dict[int, int], served: int = 1000) -> None:
        self._void_times = void_times
        self._served = served
        self.played: list[int] = []

    async def play(self, characters: int) -> Any:
        self.played.append(characters)
        is_void = self.played.count(characters) <= self._void_times.get(characters, 0)
        return Run(characters, is_void, 0.0 if characters <= self._served else 1.0)


@pytest.mark.parametrize(("void_times", "tries", "is_void"), [(0, 1, False), (2, 3, False), (9, 3, True)])
async def test_void_run_is_repeated(void_times: int, tries: int, is_void: bool) -> None:
    loads = Loads({5: void_times})
    result = await counted(lambda: loads.play(5))
    assert (len(loads.played), bool(result.void_reasons())) == (tries, is_void)


@pytest.mark.parametrize(
    ("void_times", "found"),
    [({}, (64, False)), ({64: 2}, (64, False)), ({64: 9}, (62, True)), ({66: 9}, (64, True))],
)
async def test_void_runs_do_not_pass_and_leave_the_maximum_open(
    void_times: dict[int, int], found: tuple[int, bool]
) -> None:
    loads = Loads(void_times, served=65)

    def passes(run: Any) -> bool:
        return not run.missed

    assert await most_passing(Bracket(8), loads.play, passes) == found


async def test_figures_of_a_late_load_are_marked_void(monkeypatch: pytest.MonkeyPatch) -> None:
    async def run_load(*_: object) -> Run:
        return Run(is_void=True)

    monkeypatch.setattr(served, "run_load", run_load)
    latencies = await served.edit_latencies_ms("nowhere:1", 4, 8, 1)
    assert (latencies.p50, latencies.p95, latencies.p99, latencies.is_void) == (1.0, 2.0, 3.0, True)


def test_edits_without_an_answer_are_counted_and_make_a_row_void() -> None:
    three, cpu = (1.0, 2.0, 3.0), dict.fromkeys(("engine", "event loop", "others"), 0.1)
    answered = Latency(9, 1, 20.0, three, three, three, 5, 0, 1.0, 20.0, cpu, cpu)
    lines = markdown({}, [], [answered, replace(answered, unanswered=7)]).splitlines()
    rows = [line for line in lines if line.startswith("| 9 |")]
    assert [row.split("|")[-3].strip() for row in rows] == ["0", "7"]
    assert ["void" in row for row in rows] == [False, True]
    assert {row.count("|") for row in rows} == {line.count("|") for line in lines if line.startswith("| sessions")}
