"""Twenty thousand engine steps in virtual time with a changing crowd, random costs, failures and lost reports."""

from __future__ import annotations

import random
from collections import Counter

import pytest

from server.engine.config import EngineConfig
from server.engine.types import Code, Priority, RootTarget
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

NUM_STEPS = 20_000
HANDLES = range(1, 41)


class Crowd:
    """Clients that come, edit, pause, fall silent and go, at random."""

    def __init__(self, stage: Stage, seed: int) -> None:
        self.stage = stage
        self.random = random.Random(seed)
        self.all: list[Viewer] = []

    def act(self) -> None:
        handle = self.random.choice(HANDLES)
        viewer = next((held for key, held in self.stage.viewers.items() if key.handle == handle), None)
        if viewer is None or viewer.closed is not None or viewer.refused is not None:
            self._open(handle)
        elif viewer.opened is not None:
            self._bother(viewer)

    def _open(self, handle: int) -> None:
        priority = self.random.choice(list(Priority))
        viewer = self.stage.open(
            handle,
            seed=handle,
            priority=priority,
            lookahead=self.random.choice((30, 40, 80)),
            num_steps=self.random.choice((2, 4, 10)),
            prompts=(prompt(1),),
        )
        self.stage.silent.discard(viewer.key)
        self.all.append(viewer)
        self.stage.step()

    def _bother(self, viewer: Viewer) -> None:
        match self.random.randrange(12):
            case 0 | 1 | 2 | 3:
                self.stage.set_prompts(viewer, prompt(self.random.randrange(9)))
            case 4 | 5:
                self.stage.set_prompts(viewer, prompt(3, 2, viewer.shown + self.random.randrange(90)))
            case 6 | 7:
                frame = max(0, viewer.shown + self.random.randrange(-5, 250))
                self.stage.set_constraints(viewer, RootTarget(self.random.randrange(4), frame, 0.0, 0.0))
            case 8:
                self.stage.pause(viewer, self.random.random() < 0.5)
            case 9:
                self.stage.silent.add(viewer.key)
            case 10:
                self.stage.silent.discard(viewer.key)
            case 11:
                if self.random.random() < 0.3:
                    self.stage.close(viewer)
                    self.stage.step()


@pytest.mark.parametrize(("seed", "delay_s"), [(1, 0.0), (2, 0.025)])
def test_a_long_day_breaks_no_rule(seed: int, delay_s: float) -> None:
    stage = Stage(EngineConfig(max_rows=8, max_sessions=32), delay_s=delay_s)
    crowd = Crowd(stage, seed)
    chance = random.Random(seed)

    def step_s(rows: int) -> float:
        hiccup = 60 if chance.random() < 0.005 else 1
        return chance.uniform(0.002, 0.004) * (1 + rows / 8) * hiccup

    stage.runner.step_s = step_s
    stage.runner.fails = lambda call, job_ids: chance.random() < 0.0005
    stage.runner.poisoned = lambda job: chance.random() < 0.0001
    while len(stage.reports) < NUM_STEPS // 2:
        for _ in range(chance.choice((0, 0, 0, 1, 8))):
            crowd.act()
        stage.run(0.005)
    stage.runner.fails = lambda call, job_ids: False
    stage.runner.poisoned = lambda job: False
    stage.silent.clear()
    for viewer in stage.viewers.values():
        if viewer.opened is not None and viewer.closed is None:
            stage.pause(viewer, False)
    stage.run(5.0)
    stage.check_finished()
    _check_jobs(stage)
    for viewer in crowd.all:
        assert viewer.outcomes.keys() == viewer.asked
        assert (viewer.opened is None) != (viewer.refused is None)
        allowed = {Code.OK, Code.CANCELLED, Code.FAILED_PRECONDITION, Code.NOT_FOUND, Code.RESOURCE_EXHAUSTED}
        assert {outcome.code for outcome in viewer.outcomes.values()} <= allowed
    # The day was worth the name: everything that can happen did.
    for happened in ("windows_restarted", "windows_discarded", "frames_superseded", "runner_faults", "closes"):
        assert stage.total(happened) > 0, happened
    assert any(viewer.refused for viewer in crowd.all)


def _check_jobs(stage: Stage) -> None:
    """Every job that was prepared was decoded once, or discarded, or still runs."""
    ends = Counter([*stage.runner.decoded, *stage.runner.discarded, *stage.runner.jobs])
    prepared = {job.job_id for job in stage.runner.prepared}
    assert prepared <= ends.keys()
    assert Counter(stage.runner.decoded).most_common(1)[0][1] == 1
    assert len(prepared) == len(stage.runner.prepared)
    assert not set(stage.runner.decoded) & set(stage.runner.jobs)
    assert stage.engine._owners.keys() >= stage.runner.jobs.keys()


def test_a_replay_of_the_same_events_gives_the_same_motion() -> None:
    def play() -> list[list[float]]:
        stage = Stage()
        viewers = [stage.open(handle, seed=handle, prompts=(prompt(1),)) for handle in (1, 2, 3)]
        stage.run(2.0)
        stage.set_prompts(viewers[0], prompt(2))
        stage.run(3.0)
        return [row.tolist() for viewer in viewers for row in viewer.rows]

    assert play() == play()
