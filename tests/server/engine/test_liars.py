"""Clients that report false playheads, which jump or run ahead: no other session suffers."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import CloseReason, Priority, ServiceLevel
from tests.server.engine.stage import Stage
from tests.server.engine.viewer import Viewer

Lie = Callable[[Viewer, float, random.Random], int]

LIES: dict[str, Lie] = {
    "the end of what it holds": lambda viewer, now, chance: viewer.buffered_to,
    "the last frame that it holds": lambda viewer, now, chance: max(0, viewer.buffered_to - 1),
    "a frame that does not exist": lambda viewer, now, chance: 2**53,
    "anywhere": lambda viewer, now, chance: chance.randrange(viewer.buffered_to + 100),
    "three times as fast": lambda viewer, now, chance: int(60 * (now - 100.0)),
}


def crowd(lie: Lie | None, seconds: float = 20.0) -> tuple[Stage, list[Viewer], list[Viewer]]:
    """Six honest sessions beside six that report false playheads ten times a second; none does if lie is None."""
    stage, chance = Stage(EngineConfig(max_rows=8)), random.Random(1)
    stage.runner.step_s = lambda rows: 0.004 + 0.001 * rows
    honest = [stage.open(handle, seed=handle) for handle in range(1, 7)]
    liars = [stage.open(handle, seed=handle) for handle in range(7, 13)]
    stage.silent.update(liar.key for liar in liars if lie is not None)
    for _ in range(round(10 * seconds)):
        stage.run(0.1)
        for liar in liars if lie is not None else ():
            now = stage.clock.now()
            stage.engine.submit(liar.lie(lie(liar, now, chance), now))
    return stage, honest, liars


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES.keys())
def test_false_playheads_do_not_harm_other_sessions(lie: Lie) -> None:
    stage, honest, liars = crowd(lie)
    _, calm, _ = crowd(None)
    assert not any(isinstance(output, ServiceLevel) for output in stage.outputs), "no session is degraded"
    assert all(viewer.closed is None for viewer in honest)
    assert sum(viewer.underruns for viewer in honest) == 0
    assert stage.total("deadline_misses") == 0
    for viewer, same in zip(honest, calm, strict=True):
        assert abs(viewer.buffered_to - same.buffered_to) <= 20
    for liar in liars:
        assert liar.buffered_to <= 20 * 20 * 1.05 + 2 * liar.lookahead + 60, "no more than real time and a look-ahead"


def test_playheads_that_jump_after_a_pause_do_not_harm_other_sessions() -> None:
    """Sixty sessions in turn play for a moment, pause for two seconds, and continue at the end of what they hold."""
    stage = Stage(EngineConfig(admit_load=(1000.0, 1000.0, 1000.0, 1000.0)))
    stage.runner.step_s = lambda rows: 0.012 + 0.0004 * rows
    honest = [stage.open(handle, seed=handle, priority=Priority.CROWD) for handle in range(1, 11)]
    jumping = [stage.open(handle, seed=handle, priority=Priority.CROWD) for handle in range(11, 71)]
    stage.silent.update(viewer.key for viewer in jumping)
    stage.run(2.0)
    for moment in range(250):
        for number, viewer in enumerate(jumping):
            turn = (moment + number) % 50
            if turn == 8:
                stage.pause(viewer, True)
            elif turn == 48:
                stage.pause(viewer, False)
                stage.engine.submit(viewer.lie(viewer.buffered_to, stage.clock.now() + 1e-4))
        stage.run(0.05)
    assert not any(isinstance(output, ServiceLevel) for output in stage.outputs), "no session is degraded"
    assert sum(viewer.underruns for viewer in honest) == 0


def test_playing_session_whose_playhead_stands_still_is_closed_as_idle() -> None:
    stage = Stage(EngineConfig(idle_timeout_s=10.0))
    standing, playing, paused = (stage.open(handle, priority=Priority.NEAR) for handle in (1, 2, 3))
    stage.run(1.0)
    stage.pause(paused, True)
    stage.silent.update((standing.key, paused.key))
    for _ in range(30):
        stage.run(1.0)
        for viewer in (standing, paused):
            if viewer.closed is None:
                stage.engine.submit(viewer.lie(0, stage.clock.now()))
    assert standing.closed is not None
    assert standing.closed.reason is CloseReason.IDLE
    assert playing.closed is None
    assert paused.closed is None, "a session that says it is paused has an hour"
    stage.check_finished()


def test_one_report_cannot_count_billions_of_underruns() -> None:
    stage = Stage()
    viewer = stage.open(1)
    stage.run(2.0)
    stage.engine.submit(viewer.report(stage.clock.now())._replace(underruns=2**32 - 1))
    stage.run(0.1)
    counted = [count for report in stage.reports for _, count in report.client_underruns]
    assert sum(counted) <= 20
    slacks = [slack for report in stage.reports for _, slack in report.slacks]
    assert max(slacks) < 10
