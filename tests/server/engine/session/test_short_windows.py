"""Windows of which a runner gives fewer frames than it could, and jobs whose prompt must be kept."""

from __future__ import annotations

import pytest

from motiongen_server.engine.types import Code, WindowJob
from tests.server.engine.fakes import FRAME
from tests.server.engine.stage import Stage, prompt


def _short_at(first_frame: int, count: int) -> Stage:
    """A stage whose runner gives only count frames of the window that starts at first_frame."""
    stage = Stage()

    def counts(job: WindowJob) -> int | None:
        return count if job.first_frame == first_frame else None

    stage.runner.counts = counts
    return stage


@pytest.mark.parametrize("count", [8, 22, 39])
def test_the_next_window_begins_where_a_short_one_ends(count: int) -> None:
    stage = _short_at(40, count)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(8.0)
    begun = [job.first_frame for job in stage.runner.prepared]
    assert begun[:3] == [0, 40, 40 + count]
    assert begun[3] == 80 + count
    assert viewer.underruns == 0
    assert [int(row[FRAME]) for row in viewer.rows] == list(range(len(viewer.rows)))
    stage.check_finished()


def test_a_session_may_begin_with_a_short_window() -> None:
    stage = _short_at(0, 8)
    stage.open()
    stage.run(2.0)
    assert [job.first_frame for job in stage.runner.prepared][:2] == [0, 8]
    stage.check_finished()


def test_prompt_after_a_short_window_starts_at_its_frame() -> None:
    stage = _short_at(40, 12)
    viewer = stage.open(prompts=(prompt(1), prompt(2, prompt_id=2, start=70)))
    stage.run(8.0)
    stage.check_finished()
    told = {job.first_frame: int(job.embedding[0]) for job in stage.runner.prepared if job.embedding is not None}
    assert {frame: told[frame] for frame in (40, 52, 70)} == {40: 1, 52: 1, 70: 2}
    assert all(outcome.code is Code.OK for outcome in viewer.outcomes.values())


def test_clip_of_short_windows_has_all_its_frames() -> None:
    stage = Stage()
    stage.runner.counts = lambda job: 12
    viewer = stage.open(clip_frames=50)
    stage.run(5.0)
    assert [int(row[FRAME]) for row in viewer.rows] == list(range(50))


def test_jobs_keep_their_prompt_with_keep_prompts_or_while_a_velocity_steers() -> None:
    stage = Stage()
    kept, steered = stage.open(1, keep_prompts=True), stage.open(2)
    stage.run(2.0)
    stage.set_velocity(steered, 0.0, 1.0, hold_frames=40)
    stage.run(8.0)
    assert all(job.keep_prompt for job in stage.runner.prepared if job.session == kept.key)
    jobs = [job for job in stage.runner.prepared if job.session == steered.key]
    assert {job.keep_prompt for job in jobs} == {True, False}
    assert all(job.keep_prompt == bool(job.constraints) for job in jobs), "a velocity is a constraint of its windows"
