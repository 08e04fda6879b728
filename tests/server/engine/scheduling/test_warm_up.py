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


def sizes_of(jobs: Sequence[WindowJob]) -> list[tuple[bool, int]]:
    """Of windows one behind another: whether they go on, and how many in a row."""
    return [(goes_on, len(list(alike))) for goes_on, alike in groupby(bool(len(job.history)) for job in jobs)]


def test_each_size_is_played_with_and_without_a_history() -> None:
    runner = FakeRunner()
    assert warm_up(runner, (1, 2, 5), 16) == 5
    assert sizes_of(runner.prepared) == [(goes_on, size) for size in (1, 2, 5) for goes_on in (False, True)]
    assert runner.breaches == []
    assert runner.jobs == {}, "nothing of it is left"


def test_sizes_without_memory_are_left_out() -> None:
    runner = SmallRunner()
    assert warm_up(runner, (1, 4, 8, 16), 16) == 4
    assert sizes_of(runner.prepared)[-1] == (True, 4)
