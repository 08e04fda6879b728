"""Before a runner serves, every batch size is run once, with first windows and with continuing ones."""

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
    """The runs of windows with equal histories: frames of history, and how many windows in a row."""
    return [(frames, len(list(alike))) for frames, alike in groupby(len(job.history) for job in jobs)]


def test_sizes_run_with_and_without_history_and_small_ones_with_short_ones() -> None:
    runner = FakeRunner()
    assert runner.facts.patch == 4
    assert warm_up(runner, (1, 2, 8, 9), 16) == 9
    short = [(frames, size) for size in (1, 2, 8) for frames in (0, 4, 8, 12, 16)]
    assert sizes_of(runner.prepared) == [*short, (0, 9), (16, 9)]
    assert runner.breaches == []
    assert runner.jobs == {}, "no job is left"


def test_sizes_that_do_not_fit_in_memory_are_left_out() -> None:
    runner = SmallRunner()
    assert warm_up(runner, (1, 4, 8, 16), 16) == 4
    assert sizes_of(runner.prepared)[-1] == (16, 4)


def test_size_that_runs_out_of_memory_midway_leaves_no_jobs() -> None:
    runner = FakeRunner()

    def no_room(rows: int) -> float:
        if rows > 2:
            raise OutOfMemory("no room for the steps of more than two windows")
        return 0.01

    runner.step_s = no_room
    assert warm_up(runner, (1, 2, 4), 16) == 2
    assert runner.jobs == {}
