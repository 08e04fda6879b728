"""Every size is played once, first windows and those that go on, before a runner serves."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from motiongen_server.engine.ports import OutOfMemory
from motiongen_server.engine.scheduling.warm_up import warm_up
from motiongen_server.engine.types import WindowJob
from tests.server.engine.fakes import FakeRunner


class SmallRunner(FakeRunner):
    """Has memory for four windows."""

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        if len(jobs) > 4:
            raise OutOfMemory("no room for more than four windows")
        super().prepare(jobs)


def sizes_of(jobs: Sequence[WindowJob]) -> list[tuple[int, int]]:
    """Of windows one behind another: their frames of history, and how many in a row."""
    return [(frames, len(list(alike))) for frames, alike in groupby(len(job.history) for job in jobs)]


def test_each_size_is_played_without_a_history_and_with_one_small_sizes_with_shorter_ones_too() -> None:
    runner = FakeRunner()
    assert runner.facts.patch == 4
    assert warm_up(runner, (1, 2, 8, 9), 16) == 9
    short = [(frames, size) for size in (1, 2, 8) for frames in (0, 4, 8, 12, 16)]
    assert sizes_of(runner.prepared) == [*short, (0, 9), (16, 9)]
    assert runner.breaches == []
    assert runner.jobs == {}, "nothing of it is left"


def test_sizes_without_memory_are_left_out() -> None:
    runner = SmallRunner()
    assert warm_up(runner, (1, 4, 8, 16), 16) == 4
    assert sizes_of(runner.prepared)[-1] == (16, 4)


def test_of_a_size_that_there_was_no_memory_for_half_way_nothing_is_left() -> None:
    runner = FakeRunner()

    def no_room(rows: int) -> float:
        if rows > 2:
            raise OutOfMemory("no room for the steps of more than two windows")
        return 0.01

    runner.step_s = no_room
    assert warm_up(runner, (1, 2, 4), 16) == 2
    assert runner.jobs == {}
