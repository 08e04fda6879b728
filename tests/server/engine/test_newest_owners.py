"""Owners whose share or quota has changed: the new value applies to their open sessions too."""

from __future__ import annotations

from collections import Counter

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Owner, Priority
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer

EVERYBODY = EngineConfig(admit_load=(9.0, 9.0, 9.0, 9.0), degrade=False, max_sessions=1000)
FREE, HELD = Owner("studio"), Owner("studio", steps_per_s=60.0)


def _steer(stage: Stage, viewers: list[Viewer], seconds: float) -> Counter[str]:
    """Edit every session as often as is allowed. Returns the steps that windows took meanwhile, by owner."""
    before = len(stage.runner.batches)
    for marker in range(round(seconds / 0.05)):
        stage.run(0.05)
        for viewer in viewers:
            stage.set_prompts(viewer, prompt(marker))
    owners = {job.job_id: job.owner.name for job in stage.runner.prepared}
    return Counter(owners[job_id] for batch in stage.runner.batches[before:] for job_id in batch)


def test_reduced_quota_limits_sessions_that_are_already_open() -> None:
    stage = Stage(EVERYBODY)
    viewers = [stage.open(n, seed=n, priority=Priority.HERO, owner=FREE) for n in range(1, 7)]
    freely = _steer(stage, viewers, 10.0)["studio"]
    stage.engine.intake.note_owner(HELD)
    held = _steer(stage, viewers, 10.0)["studio"]
    assert freely > 1000
    assert held <= 60 * (10 + 2)  # including steps that were saved up, and windows that had begun
    assert all(viewer.underruns == 0 for viewer in viewers)
    stage.engine.intake.note_owner(FREE)
    assert _steer(stage, viewers, 10.0)["studio"] > 0.9 * freely


def test_increased_share_applies_to_sessions_that_are_already_open() -> None:
    stage = Stage(EVERYBODY)
    stage.runner.step_s = lambda rows: 0.01 + 0.01 * rows
    one, other = (
        [stage.open(first + n, seed=n, priority=Priority.HERO, owner=Owner(name)) for n in range(40)]
        for name, first in (("one", 1), ("other", 101))
    )
    alike = _steer(stage, one + other, 10.0)
    stage.engine.intake.note_owner(Owner("one", weight=3.0))
    _steer(stage, one + other, 4.0)  # windows from before the change end
    unlike = _steer(stage, one + other, 10.0)
    assert 0.9 < alike["one"] / alike["other"] < 1.1
    assert unlike["one"] / unlike["other"] > 1.5  # not 3: windows that the other needs to play on go ahead of edits


def test_session_opened_with_outdated_owner_limits_gets_the_newest_ones() -> None:
    stage = Stage(EVERYBODY)
    stage.engine.intake.note_owner(HELD)
    stage.run(0.1)
    late, another = stage.open(1, owner=FREE), stage.open(2, owner=Owner("another"))
    stage.run(0.1)
    assert stage.engine.sessions[late.key].spec.owner == HELD
    assert stage.engine.sessions[another.key].spec.owner == Owner("another")


def test_closed_session_frees_its_place_after_its_owner_has_changed() -> None:
    stage = Stage(EngineConfig(admit_load=(9.0, 9.0, 9.0, 9.0), max_sessions=1))
    first = stage.open(1, owner=FREE)
    stage.run(0.5)
    stage.engine.intake.note_owner(HELD)
    stage.run(0.5)
    stage.close(first)
    stage.run(0.5)
    second = stage.open(2, owner=HELD)
    stage.run(0.5)
    assert (second.refused, bool(second.rows)) == (None, True)
    assert stage.engine.admission.asked > 0
    stage.close(second)
    stage.run(0.5)
    assert stage.engine.admission.asked == 0
