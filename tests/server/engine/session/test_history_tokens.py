"""Windows that start on the token grid: their history is not encoded again."""

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Code, PlanCause, Priority
from tests.server.engine.session.playing import num_edit_plans, playing_state, waypoint
from tests.server.engine.stage import prompt


def test_only_windows_on_the_token_grid_get_the_tokens_of_their_history() -> None:
    stage, viewer, _ = playing_state()
    stage.set_prompts(viewer, prompt(2, 2, viewer.shown // 4 * 4 + 17))
    stage.run(6.0)
    starts = [job.first_frame for job in stage.runner.prepared]
    for before, job in zip([0, *starts], stage.runner.prepared, strict=False):
        on_grid = job.first_frame > 0 and (job.first_frame - before) % 4 == 0
        assert (job.history_tokens is not None) == on_grid, job.first_frame
    assert any(job.history_tokens is None for job in stage.runner.prepared[1:])


def test_aligned_replans_stay_on_the_token_grid() -> None:
    stage, viewer, _ = playing_state(EngineConfig(align_within=10_000))
    for n in range(20):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.33)
    assert num_edit_plans(viewer) > 10
    assert all(job.first_frame % 4 == 0 for job in stage.runner.prepared)
    assert all(job.history_tokens is not None for job in stage.runner.prepared[1:])


def test_replans_in_quick_succession_begin_on_the_grid_of_the_first() -> None:
    stage, viewer, _ = playing_state(priority=Priority.HERO)
    before = len(stage.runner.prepared)
    for n in range(20):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.1)
    first, *later = [job for job in stage.runner.prepared[before:] if job.cause is PlanCause.EDIT]
    assert len(later) > 15
    assert {(job.first_frame - first.first_frame) % 4 for job in later} == {0}
    assert all(job.history_tokens is not None for job in later[3:]), "once a history lies behind the first"


@pytest.mark.parametrize("quiet_s", [1.5, 1.55, 1.6, 1.65])
def test_edit_after_a_quiet_time_is_not_delayed_by_alignment(quiet_s: float) -> None:
    shown = []
    for align_within in (EngineConfig().align_within, 0):
        stage, viewer, _ = playing_state(EngineConfig(align_within=align_within))
        stage.set_prompts(viewer, prompt(2))
        stage.run(quiet_s)
        seq = stage.set_prompts(viewer, prompt(3))
        stage.run(0.2)
        shown.append(viewer.outcomes[seq].effective_frame)
    assert shown[0] == shown[1]


def test_alignment_skips_no_frame_of_a_constraint() -> None:
    stage, viewer, _ = playing_state(priority=Priority.HERO)
    for n in range(30):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.1)
        near = stage.engine.sessions[viewer.key].replaceable_from(stage.clock.now(), 0.27)
        seq = stage.set_constraints(viewer, waypoint(near, constraint_id=n))
        stage.run(0.1)
        if viewer.outcomes[seq].code is Code.OK:
            assert viewer.notices[-1].valid_from <= near, "the plan that answers it holds its frame"


def test_aligned_replan_starts_a_scheduled_prompt_at_its_own_frame() -> None:
    stage, viewer, _ = playing_state(EngineConfig(align_within=10_000))
    start = viewer.shown // 4 * 4 + 17
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(0.2)
    assert start % 4
    assert viewer.outcomes[seq].effective_frame == start


def test_no_window_gets_history_tokens_when_reuse_tokens_is_off() -> None:
    stage, _, _ = playing_state(EngineConfig(reuse_tokens=False))
    stage.run(5.0)
    assert len(stage.runner.prepared) > 3
    assert all(job.history_tokens is None for job in stage.runner.prepared)
