"""Owners in virtual time: when one overloads the machine, the others keep their share, and quotas hold."""

from dataclasses import replace

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.owner_parts import OwnerParts
from motiongen_server.engine.scheduling.owner_shares import OwnerShares
from motiongen_server.engine.types import Code, Owner, Priority, ServiceTier
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

EVERYBODY = EngineConfig(admit_load=(9.0, 9.0, 9.0, 9.0), degrade=False, max_sessions=1000)
LARGE, SMALL = Owner("large"), Owner("small")


def _contest() -> tuple[list[Viewer], list[Viewer]]:
    """Nearly twice what the machine can do, almost all of it for one owner, whose sessions also come first by class."""
    stage = Stage(EVERYBODY)
    stage.runner.step_s = lambda rows: 0.002 + 0.004 * rows
    large = [stage.open(n, seed=n, priority=Priority.HERO, owner=LARGE) for n in range(1, 201)]
    small = [stage.open(n, seed=n, priority=Priority.CROWD, owner=SMALL) for n in range(301, 325)]
    stage.run(20.0)
    return large, small


def test_only_the_owner_that_overloads_the_machine_has_underruns() -> None:
    large, small = _contest()
    assert sum(viewer.underruns for viewer in large) > 100
    assert [viewer.underruns for viewer in small] == [0] * 24


def test_without_reserved_shares_other_owners_have_underruns_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OwnerShares, "reserved", lambda self, may_run: iter(()))
    _, small = _contest()
    assert sum(viewer.underruns for viewer in small) > 0


def _steered(owner: Owner) -> Stage:
    """Six hero sessions of this owner, edited for 10 s as fast as is allowed."""
    stage = Stage(EVERYBODY)
    viewers = [stage.open(n, seed=n, priority=Priority.HERO, owner=owner) for n in range(1, 7)]
    for marker in range(200):
        stage.run(0.05)
        for viewer in viewers:
            stage.set_prompts(viewer, prompt(marker))
    assert all(viewer.underruns == 0 for viewer in viewers)
    stage.run(5.0)
    stage.check_finished()
    return stage


def test_quota_delays_its_owners_replans_but_causes_no_underruns() -> None:
    freely, held = _steered(Owner("studio")), _steered(Owner("studio", steps_per_s=60.0))
    steps_freely, steps_held = (sum(len(batch) for batch in stage.runner.batches) for stage in (freely, held))
    assert steps_freely > 1500
    assert steps_held <= 60 * (15 + 1)


def test_window_replaced_by_edits_before_its_first_step_is_charged_once() -> None:
    """Hero sessions of another owner take every step, and each edit that comes meanwhile replaces the one before."""
    owner = Owner("studio", steps_per_s=100.0)
    stage = Stage(replace(EVERYBODY, max_rows=4))
    stage.runner.step_s = lambda rows: 0.03
    viewer = stage.open(1, priority=Priority.BATCH, owner=owner)
    heroes = [stage.open(n, seed=n, priority=Priority.HERO, owner=LARGE) for n in range(2, 18)]
    stage.run(3.0)
    for marker in range(100):
        stage.set_prompts(viewer, prompt(marker))
        for hero in heroes if marker % 3 == 0 else ():
            stage.set_prompts(hero, prompt(marker))
        stage.run(0.03)
    stage.run(5.0)
    mine = {job.job_id for job in stage.runner.prepared if job.session == viewer.key}
    charged = sum(steps for report in stage.reports for _, steps in report.quota_steps)
    assert charged == 4 * len(mine)
    begun = {job.job_id for job in stage.runner.prepared}
    assert len(set(stage.runner.discarded) - begun) > 20, "many windows never began"


def test_owner_gets_no_more_windows_at_once_than_it_has_saved_steps_for() -> None:
    """All sessions of an owner, paused, are edited at once; the owner has saved up steps for ten windows."""
    stage = Stage(EVERYBODY)
    viewers = [stage.open(n, seed=n, owner=Owner("studio", steps_per_s=40.0)) for n in range(1, 61)]
    stage.run(1.0)
    for viewer in viewers:
        stage.pause(viewer, True)
    stage.run(5.0)
    for viewer in viewers:
        stage.set_prompts(viewer, prompt(1))
    assert not stage.engine.windows.owners
    stage.engine.step()
    assert len(stage.engine.windows.owners) == 10


def _steered_at(stages: list[Stage], owner: Owner, seconds: float) -> list[int]:
    """Six hero sessions at each of these engines, edited as fast as is allowed. Returns the steps that each engine did.

    Every tenth of a second each engine is told what the others did for the owner, as from their processes.
    """
    viewers = [[stage.open(n, seed=n, priority=Priority.HERO, owner=owner) for n in range(1, 7)] for stage in stages]
    heard = [0] * len(stages)
    for marker in range(round(seconds / 0.1)):
        for number, stage in enumerate(stages):
            stage.run(0.1)
            for viewer in viewers[number]:
                stage.set_prompts(viewer, prompt(marker))
        for number, stage in enumerate(stages):
            taken = [each for report in stage.reports[heard[number] :] for each in report.quota_steps]
            heard[number] = len(stage.reports)
            for other in stages:
                if other is not stage:
                    other.engine.intake.note_steps_elsewhere(tuple(taken))
    assert all(viewer.underruns == 0 for there in viewers for viewer in there)
    return [sum(len(batch) for batch in stage.runner.batches) for stage in stages]


def test_quota_covers_all_engines_together_and_one_alone_may_use_all_of_it() -> None:
    owner, seconds = Owner("studio", steps_per_s=100.0), 20.0
    stage = Stage(EVERYBODY)
    began_at = stage.clock.now()
    (alone,) = _steered_at([stage], owner, seconds)
    lived_s = stage.clock.now() - began_at
    together = _steered_at([Stage(EVERYBODY) for _ in range(3)], owner, seconds)
    assert 100 * seconds * 0.9 < alone <= 100 * (lived_s + 1)
    # At first each engine has a second's steps saved up; from then on the quota holds, and no engine is left out.
    assert 100 * seconds * 0.9 < sum(together) <= 100 * (seconds + 3)
    assert min(together) > 0.2 * sum(together)


def test_a_clip_waits_for_its_owners_quota_too() -> None:
    stage = Stage(EVERYBODY)
    clip = stage.open_clip(1, 400, owner=Owner("studio", steps_per_s=8.0))
    stage.run(1.0)
    assert sum(len(batch) for batch in stage.runner.batches) <= 16
    stage.run_until(lambda: clip.closed is not None, limit_s=20.0)
    assert clip.closed is not None
    assert clip.closed.code is Code.OK


def _beside_edits(newcomer: Owner) -> tuple[list[Viewer], list[Viewer]]:
    """Twelve sessions that are edited as often as is allowed, which is all that the machine can do, and eight that an
    owner opens beside them, one every half second. Returns the viewers of both."""
    stage = Stage(EngineConfig(max_sessions=1000))
    stage.runner.step_s = lambda rows: 0.01 + 0.005 * rows
    edited = [stage.open(n, seed=n, owner=LARGE) for n in range(1, 13)]
    came = []
    for marker in range(100):
        stage.run(0.1)
        for viewer in edited:
            stage.set_prompts(viewer, prompt(marker))
        if marker > 30 and marker % 5 == 0 and len(came) < 8:
            came.append(stage.open(100 + marker, seed=marker, priority=Priority.CROWD, owner=newcomer))
    assert stage.engine.admission.load > 0.9
    return edited, came


def test_edits_beyond_their_owners_part_neither_exclude_nor_delay_others() -> None:
    edited, came = _beside_edits(SMALL)
    assert [viewer.refused for viewer in came] == [None] * 8
    assert all(viewer.rows for viewer in came)
    assert [viewer.underruns for viewer in edited + came] == [0] * 20
    assert {level.tier for viewer in edited + came for level in viewer.levels} <= {ServiceTier.FULL}


def test_own_edits_count_against_an_owner_that_opens_more_sessions() -> None:
    _, came = _beside_edits(LARGE)
    assert all(viewer.refused is not None and viewer.refused.reason == "OVERLOADED" for viewer in came)


def test_if_all_edits_counted_other_owners_would_be_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(OwnerParts, "yielding", lambda self, prices, edits_hz, asks=None: 0.0)
    _, came = _beside_edits(SMALL)
    assert all(viewer.refused is not None and viewer.refused.reason == "OVERLOADED" for viewer in came)
