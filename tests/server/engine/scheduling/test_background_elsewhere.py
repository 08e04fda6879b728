"""Clips of one model beside sessions of another on one device: they get what the sessions leave, and always some."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.device import Device
from tests.server.engine.fakes import FakeClock
from tests.server.engine.stage import Stage

ROW_S = 0.005
CALL_S = 0.002
STEP_S = 0.02
ANY_LOAD = (1000.0, 1000.0, 1000.0, 1000.0)
CONFIG = EngineConfig(max_step_s=STEP_S, admit_load=ANY_LOAD, degrade=False)


class Turns:
    """Stages that take turns on one device in virtual time, in the order in which they ask."""

    def __init__(self, num_stages: int) -> None:
        self.clock, self.device = FakeClock(), Device()
        self.leases = [self.device.lease() for _ in range(num_stages)]
        self.stages = [Stage(CONFIG, clock=self.clock, lease=lease) for lease in self.leases]
        self.taken_s = [0.0] * num_stages
        self._asks_at = [self.clock.now()] * num_stages
        for stage in self.stages:
            stage.runner.step_s = lambda rows: ROW_S * rows
            stage.runner.fails = self._take_call_s

    def _take_call_s(self, call: str, job_ids: Sequence[int]) -> bool:
        """Preparing and decoding windows takes time, too; no call fails."""
        self.clock.advance(CALL_S if call in ("prepare", "decode") else 0.0)
        return False

    def run(self, seconds: float) -> None:
        ends_at = self.clock.now() + seconds
        while (now := self.clock.now()) < ends_at:
            for number, stage in enumerate(self.stages):
                stage.report_playheads()
                if len(stage.engine._mailbox):
                    self._asks_at[number] = min(self._asks_at[number], now)
            number = min(range(len(self.stages)), key=lambda each: self._asks_at[each])
            if self._asks_at[number] > now:
                self.clock.advance(min(self._asks_at[number] - now, 0.01))  # for playheads that are due meanwhile
                continue
            stage = self.stages[number]
            with self.leases[number]:
                report = stage.step()
            after = self.clock.now()
            self.taken_s[number] += after - now
            self._asks_at[number] = after if report.rows else after + max(stage.engine.idle_s(), 1e-4)
        for stage in self.stages:
            for viewer in stage.viewers.values():
                viewer.play(self.clock.now())


def clips(stage: Stage, num: int) -> None:
    for handle in range(1, num + 1):
        stage.open_clip(handle, 2000, seed=handle)


@pytest.mark.parametrize(("num_sessions", "load"), [(50, 0.6), (65, 0.8)])
def test_sessions_miss_no_deadline_beside_the_clips_of_another_model(num_sessions: int, load: float) -> None:
    turns = Turns(2)
    with_clips, with_sessions = turns.stages
    for handle in range(1, num_sessions + 1):
        with_sessions.open(handle, seed=handle)
        turns.run(0.1)
    settled, had_s = with_sessions.total("deadline_misses"), turns.taken_s[1]
    turns.run(10.0)
    assert (turns.taken_s[1] - had_s) / 10.0 == pytest.approx(load, abs=0.05)
    clips(with_clips, 8)
    turns.run(20.0)
    assert with_sessions.total("deadline_misses") == settled == 0
    assert not any(viewer.underruns for viewer in with_sessions.viewers.values())
    assert turns.taken_s[0] > 0.05 * 20.0, "clips had what the sessions left"


def test_session_of_a_model_whose_clips_are_held_back_starts_promptly() -> None:
    turns = Turns(2)
    with_clips, with_sessions = turns.stages
    clips(with_clips, 8)
    for handle in range(1, 61):
        with_sessions.open(handle, seed=handle)
        turns.run(0.1)
    assert turns.leases[0].num_background
    came_at = turns.clock.now()
    viewer = with_clips.open(100)
    while not viewer.buffered_to:
        turns.run(0.001)
    assert turns.clock.now() - came_at < 0.5
    assert with_sessions.total("deadline_misses") == 0


def test_stopping_engine_waits_without_spinning_while_its_clips_are_held_back() -> None:
    turns = Turns(2)
    with_clips, with_sessions = turns.stages
    clips(with_clips, 8)
    with_sessions.open(1)
    turns.run(1.0)
    turns.leases[1].num_waited_for = 1
    engine = with_clips.engine
    while turns.leases[0].spare_s > 0.0:
        with turns.leases[0]:
            with_clips.step()
    waited: list[float] = []
    engine._mailbox.wait = waited.append  # type: ignore[method-assign]
    with turns.leases[0]:
        assert not with_clips.step().rows
    engine.stop()
    assert not engine.finished
    engine.wait()
    assert waited, "otherwise its loop spins"


def test_lease_counts_background_windows_and_windows_that_sessions_wait_for() -> None:
    turns = Turns(1)
    (stage,), (lease,) = turns.stages, turns.leases
    clips(stage, 3)
    turns.run(0.01)
    assert (lease.num_background, lease.num_waited_for) == (3, 0)
    stage.open(100)
    stage.run_until(lambda: lease.num_waited_for > 0)
    assert (lease.num_background, lease.num_waited_for) == (3, 1)
    stage.run_until(lambda: lease.num_waited_for == 0)
    for viewer in list(stage.viewers.values()):
        stage.close(viewer)
    turns.run(0.1)
    assert (lease.num_background, lease.num_waited_for) == (0, 0)
