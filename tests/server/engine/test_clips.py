"""Clips: bounded motion that is made as fast as capacity allows, and what they leave to the sessions."""

from __future__ import annotations

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import (
    CloseReason,
    Code,
    Playhead,
    Priority,
    ServiceLevel,
    SessionKey,
    Waypoint,
    WindowJob,
)
from tests.server.engine.fakes import CONSTRAINTS, FRAME, PROMPT, ROW_WIDTH, SEED
from tests.server.engine.stage import Stage, prompt


def prior_rows(num_frames: int) -> np.ndarray:
    """The frames just before frame 0."""
    rows = np.zeros((num_frames, ROW_WIDTH), np.float32)
    rows[:, FRAME] = np.arange(-num_frames, 0)
    rows[:, 1:4] = (1.0, 0.0, 1.0)
    return rows


@pytest.mark.parametrize("num_frames", [1, 40, 41, 90, 200])
def test_clip_has_exactly_its_frames_and_then_closes(num_frames: int) -> None:
    stage = Stage()
    clip = stage.open_clip(1, num_frames)
    stage.run(1.0)
    assert [int(row[FRAME]) for row in clip.rows] == list(range(num_frames))
    assert clip.closed is not None
    assert (clip.closed.reason, clip.closed.code, clip.closed.num_frames) == (CloseReason.CLIENT, Code.OK, num_frames)
    assert stage.engine.num_sessions == 0
    assert len(stage.runner.decoded) == -(-num_frames // 40), "no more windows than it takes"
    stage.check_finished()


def test_clip_is_made_without_waiting_for_playheads() -> None:
    stage = Stage()
    clip = stage.open_clip(1, 400)
    begun_at = stage.clock.now()
    stage.run_until(lambda: clip.closed is not None)
    assert stage.clock.now() - begun_at < 1.0, "twenty seconds of motion"


def test_clip_is_made_only_as_far_as_its_look_ahead_reaches() -> None:
    stage = Stage()
    clip = stage.open_clip(1, 300, lookahead=160)
    stage.run(2.0)
    assert len(clip.rows) == 160
    assert len(stage.runner.decoded) == 4
    for _ in range(5):
        clip.reported = len(clip.rows)
        stage.engine.submit(Playhead(clip.key, 0, stage.clock.now(), len(clip.rows), len(clip.rows), 0, None))
        stage.run(1.0)
    assert [int(row[FRAME]) for row in clip.rows] == list(range(300))
    assert clip.closed is not None
    stage.check_finished()


def test_clips_and_sessions_share_denoising_steps() -> None:
    stage = Stage()
    viewer = stage.open(1)
    clips = [stage.open_clip(handle, 120, seed=handle) for handle in range(2, 10)]
    stage.run(3.0)
    assert max(len(batch) for batch in stage.runner.batches) == 9
    for clip in clips:
        assert {int(row[SEED]) for row in clip.rows} == {clip.key.handle}
    assert viewer.underruns == 0
    stage.check_finished()


def test_clip_prompts_change_at_their_frames_and_every_window_gets_the_constraints() -> None:
    stage = Stage()
    goal = Waypoint(1, 100, 0.0, 1.0)
    prompts = (prompt(3, 1, 0, 50), prompt(7, 2, 50, None))
    clip = stage.open_clip(1, 120, prompts=prompts, constraints=(goal,))
    stage.run(1.0)
    assert [int(row[PROMPT]) for row in clip.rows] == [3] * 50 + [7] * 70
    assert {int(row[CONSTRAINTS]) for row in clip.rows} == {1}, "every window gets the waypoint"


def test_windows_use_the_history_length_that_was_asked_for() -> None:
    stage = Stage()
    stage.open_clip(1, 120, history_frames=40)
    stage.open_clip(2, 120, history_frames=4)
    stage.open(3)
    stage.run(4.0)
    longest = {
        handle: max(len(job.history) for job in stage.runner.prepared if job.session.handle == handle)
        for handle in (1, 2, 3)
    }
    assert longest == {1: 40, 2: 4, 3: 16}
    stage.check_finished()


@pytest.mark.parametrize("is_clip", [True, False])
def test_first_window_continues_from_prior_frames(is_clip: bool) -> None:
    stage = Stage()
    seeded = stage.open_clip if is_clip else lambda handle, _, **fields: stage.open(handle, **fields)
    viewer = seeded(1, 120, prior_rows=prior_rows(24))
    stage.run(3.0)
    first = stage.runner.prepared[0]
    assert first.start_pose is None
    assert list(first.history[:, 0]) == list(range(-16, 0)), "as many of them as a window sees"
    assert [int(row[FRAME]) for row in viewer.rows[:50]] == list(range(50)), "the prior frames are not sent again"
    stage.check_finished()


def test_prior_frames_that_the_runner_cannot_convert_refuse_the_open() -> None:
    stage = Stage()
    stage.runner.fails = lambda call, _: call == "features"
    refused = stage.open_clip(1, 40, prior_rows=prior_rows(8))
    other = stage.open(2)
    stage.run(0.5)
    assert refused.refused is not None
    assert (refused.refused.code, refused.refused.reason) == (Code.INTERNAL, "PRIOR_FRAMES_FAILED")
    assert other.rows
    assert stage.engine.num_sessions == 1


def test_closing_a_clip_stops_its_work_within_a_step() -> None:
    stage = Stage()
    clip = stage.open_clip(1, 4000)
    stage.run(0.3)
    stage.close(clip)
    stage.step()
    batches = len(stage.runner.batches)
    assert stage.runner.jobs == {}
    stage.run(1.0)
    assert len(stage.runner.batches) == batches
    assert clip.closed is not None


def test_clips_beyond_max_clips_are_refused_and_clips_take_no_session_places() -> None:
    stage = Stage(EngineConfig(max_clips=2, max_sessions=1))
    stage.open(1)
    clips = [stage.open_clip(handle, 400) for handle in range(2, 5)]
    stage.step()
    refused = [clip.refused for clip in clips]
    assert refused[:2] == [None, None], "clips take no places of sessions"
    assert refused[2] is not None
    assert (refused[2].code, refused[2].reason) == (Code.RESOURCE_EXHAUSTED, "CLIP_LIMIT")
    assert refused[2].retry_after_s is not None
    stage.run(2.0)
    again = stage.open_clip(5, 40)
    stage.run(1.0)
    assert len(again.rows) == 40


def test_clips_affect_neither_measured_load_nor_degradation_nor_deadlines() -> None:
    """The device is busy all the time, almost only with background work."""
    stage = Stage(EngineConfig(initial_step_s=0.01))
    stage.runner.step_s = lambda rows: 0.005 * rows
    for handle in range(2, 18):
        stage.open_clip(handle, 8000)
    heroes = [stage.open(handle, priority=Priority.HERO) for handle in range(100, 104)]
    stage.run(20.0)
    loads = [report.load for report in stage.reports if report.load is not None]
    assert max(loads) < 0.5, "what clips take is free for sessions"
    assert not [output for output in stage.outputs if isinstance(output, ServiceLevel)]
    assert [hero.underruns for hero in heroes] == [0] * 4
    assert stage.total("deadline_misses") == 0
    assert all(any(job.session == SessionKey(1, handle) for job in stage.runner.prepared) for handle in range(2, 18))


def test_background_rows_do_not_lengthen_steps() -> None:
    stage = Stage(EngineConfig(initial_step_s=0.01))
    stage.runner.step_s = lambda rows: 0.01 * rows
    for handle in range(2, 34):
        stage.open_clip(handle, 400)
    stage.run(20.0)
    sizes = [len(batch) for batch in stage.runner.batches]
    assert max(sizes[50:]) <= 4, "a session that opens during a step waits for its end"


def test_steps_with_session_rows_hold_few_background_rows() -> None:
    stage = Stage(EngineConfig(initial_step_s=0.01))
    stage.runner.step_s = lambda rows: 0.004 * rows
    for handle in range(2, 34):
        stage.open_clip(handle, 8000)
    stage.run(3.0)
    viewer = stage.open(1, priority=Priority.HERO)
    stage.run(6.0)
    jobs = {job.job_id: job for job in stage.runner.prepared}
    shared = [
        len(batch) for batch in stage.runner.batches if any(jobs[job_id].session == viewer.key for job_id in batch)
    ]
    assert shared
    assert max(shared) <= 3, "its own row and those owed to the class of clips"


@pytest.mark.parametrize("lost_plans", [set(), {2}, {2, 3}, set(range(2, 100))])
def test_clip_takes_no_longer_if_its_character_is_lost_and_continues_from_a_fresh_start(lost_plans: set[int]) -> None:
    """No playhead is reported, so that only its own windows wake the session."""
    stage = Stage()
    stage.runner.rights = True

    def move(job: WindowJob, frames: np.ndarray) -> None:
        if job.plan in lost_plans:
            frames[:, 1] = 9.0

    stage.runner.moves = move
    clip, begun_at = stage.open_clip(1, 300), stage.clock.now()
    stage.run_until(lambda: clip.closed is not None)
    assert stage.clock.now() - begun_at == pytest.approx(0.32), "eight windows of four steps of 0.01 s"
    assert len(clip.rows) == 300
    fresh = {job.plan for job in stage.runner.prepared if job.start_pose is not None}
    assert fresh == {1, *(plan + 1 for plan in lost_plans if plan < 8)}
