"""A simulated day of an engine in virtual time: a changing crowd, random costs, failures, lost reports."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Sequence

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.ports import OutOfMemory
from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.types import Code, Priority, ServiceTier, Waypoint
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer
from tests.server.engine.watched import WatchedScheduler

HANDLES = range(1, 41)
ALLOWED = {Code.OK, Code.CANCELLED, Code.FAILED_PRECONDITION, Code.NOT_FOUND, Code.RESOURCE_EXHAUSTED}


class Crowd:
    """Clients that randomly come, edit, pause, report false playheads, fall silent and leave."""

    def __init__(self, stage: Stage, chance: random.Random) -> None:
        self.stage = stage
        self.random = chance
        self.all: list[Viewer] = []

    def act(self) -> None:
        handle = self.random.choice(HANDLES)
        viewer = next((held for key, held in self.stage.viewers.items() if key.handle == handle), None)
        if viewer is None or viewer.closed is not None or viewer.refused is not None:
            self._open(handle)
        elif viewer.opened is not None:
            self._bother(viewer)

    def _open(self, handle: int) -> None:
        viewer = self.stage.open(
            handle,
            seed=handle,
            priority=self.random.choice(list(Priority)),
            lookahead=self.random.choice((30, 40, 80)),
            num_steps=self.random.choice((2, 4, 10)),
            prompts=(prompt(1),),
        )
        self.stage.silent.discard(viewer.key)
        self.all.append(viewer)
        self.stage.step()

    def _bother(self, viewer: Viewer) -> None:
        match self.random.randrange(14):
            case 0 | 1 | 2 | 3:
                self.stage.set_prompts(viewer, prompt(self.random.randrange(9)))
            case 4 | 5:
                self.stage.set_prompts(viewer, prompt(3, 2, viewer.shown + self.random.randrange(90)))
            case 6 | 7:
                frame = max(0, viewer.shown + self.random.randrange(-5, 250))
                self.stage.set_constraints(viewer, Waypoint(self.random.randrange(4), frame, 0.0, 0.0))
            case 8:
                self.stage.pause(viewer, self.random.random() < 0.5)
            case 9:
                self.stage.silent.add(viewer.key)
            case 10:
                self.stage.silent.discard(viewer.key)
            case 11:
                self.stage.set_velocity(viewer, self.random.uniform(-2, 2), 1.0, None, self.random.randrange(1, 90))
            case 12:
                frame = self.random.choice(
                    (viewer.buffered_to, max(0, viewer.buffered_to - 1), 2**53, 0, 3 * viewer.shown, viewer.shown + 30)
                )
                self.stage.engine.submit(viewer.lie(frame, self.stage.clock.now()))
            case 13:
                if self.random.random() < 0.3:
                    self.stage.close(viewer)
                    self.stage.step()


class Day:
    """One engine and its clients. Everything in it follows from the seed."""

    def __init__(self, seed: int) -> None:
        chance = self._chance = random.Random(seed)
        max_rows = chance.choice((1, 4, 8, 16))
        self.scheduler = WatchedScheduler(CostTable.assumed(0.01), max_rows)
        config = EngineConfig(
            max_rows=max_rows,
            max_sessions=32,
            degrade=chance.random() < 0.5,
            admit_load=chance.choice(((0.95, 0.9, 0.85, 0.7), (9.0, 9.0, 9.0, 9.0))),
            align_within=chance.choice((0, 16, 10_000)),
        )
        delay_s = chance.choice((0.0, 0.01, 0.025))
        self.stage = Stage(config, delay_s=delay_s, scheduler=self.scheduler)
        self.crowd = Crowd(self.stage, chance)
        runner = self.stage.runner
        runner.holds = config.degrade
        runner.passes = lambda job: 1 + job.job_id % 3
        runner.step_s = self._step_s
        runner.fails = self._fails
        runner.poisoned = lambda job: chance.random() < 0.0001
        self._slowness = chance.choice((0.5, 1.0, 3.0))

    def _step_s(self, rows: int) -> float:
        hiccup = 60 if self._chance.random() < 0.005 else 1
        return self._slowness * self._chance.uniform(0.002, 0.004) * (1 + rows / 8) * hiccup

    def _fails(self, call: str, job_ids: Sequence[int]) -> bool:
        del call
        if len(job_ids) > 2 and self._chance.random() < 0.0005:
            raise OutOfMemory
        return self._chance.random() < 0.0005

    def live(self, num_steps: int) -> None:
        """Run so many steps of the engine; a broken rule raises at once."""
        while len(self.stage.reports) < num_steps:
            for _ in range(self._chance.choice((0, 0, 0, 1, 8))):
                self.crowd.act()
            self.stage.run(0.005)

    def end(self) -> None:
        """Let everything come to rest without further failures, and check the totals."""
        stage = self.stage
        stage.runner.fails = lambda call, job_ids: False
        stage.runner.poisoned = lambda job: False
        stage.runner.step_s = lambda rows: 0.002
        stage.silent.clear()
        for viewer in stage.viewers.values():
            if viewer.opened is not None and viewer.closed is None:
                stage.pause(viewer, False)
        stage.run(5.0)
        # A pose is held for some more time, during which its session's edits wait.
        limit_at = stage.clock.now() + 400.0
        while ServiceTier.HOLD in stage.tiers().values():
            assert stage.clock.now() < limit_at, "sessions still hold a pose after 400 s"
            stage.run(1.0)
        stage.run(5.0)
        stage.check_finished()
        self._check_jobs()
        for viewer in self.crowd.all:
            assert viewer.outcomes.keys() == viewer.asked
            assert (viewer.opened is None) != (viewer.refused is None)
            assert {outcome.code for outcome in viewer.outcomes.values()} <= ALLOWED

    def _check_jobs(self) -> None:
        """Check that every prepared job was decoded once, was discarded, or still runs."""
        runner, owners = self.stage.runner, self.stage.engine.windows.owners
        ends = Counter([*runner.decoded, *runner.discarded, *runner.jobs])
        prepared = {job.job_id for job in runner.prepared}
        assert prepared <= ends.keys()
        assert len(prepared) == len(runner.prepared)
        assert max(Counter(runner.decoded).values(), default=0) <= 1
        assert not set(runner.decoded) & set(runner.jobs)
        assert owners.keys() >= runner.jobs.keys()
        assert len(owners) == len(self.scheduler)
