"""Windows on the grid of tokens: their history is not encoded again."""

from motiongen_server.engine.config import EngineConfig
from tests.server.engine.session.playing import num_edit_plans, playing_state
from tests.server.engine.stage import prompt


def test_windows_on_the_grid_get_the_tokens_of_their_history_and_others_do_not() -> None:
    stage, viewer, _ = playing_state()
    stage.set_prompts(viewer, prompt(2, 2, viewer.shown // 4 * 4 + 17))
    stage.run(6.0)
    starts = [job.first_frame for job in stage.runner.prepared]
    for before, job in zip([0, *starts], stage.runner.prepared, strict=False):
        on_grid = job.first_frame > 0 and (job.first_frame - before) % 4 == 0
        assert (job.history_tokens is not None) == on_grid, job.first_frame
    assert any(job.history_tokens is None for job in stage.runner.prepared[1:])


def test_aligned_replans_stay_on_the_grid() -> None:
    stage, viewer, _ = playing_state(EngineConfig(align_replans=True))
    for n in range(20):
        stage.set_prompts(viewer, prompt(n))
        stage.run(0.33)
    assert num_edit_plans(viewer) > 10
    assert all(job.first_frame % 4 == 0 for job in stage.runner.prepared)
    assert all(job.history_tokens is not None for job in stage.runner.prepared[1:])


def test_an_aligned_replan_still_starts_a_scheduled_prompt_where_it_was_asked_for() -> None:
    stage, viewer, _ = playing_state(EngineConfig(align_replans=True))
    start = viewer.shown // 4 * 4 + 17
    seq = stage.set_prompts(viewer, prompt(2, 2, start))
    stage.run(0.2)
    assert start % 4
    assert viewer.outcomes[seq].effective_frame == start


def test_history_can_be_had_encoded_again_every_time() -> None:
    stage, _, _ = playing_state(EngineConfig(reuse_tokens=False))
    stage.run(5.0)
    assert len(stage.runner.prepared) > 3
    assert all(job.history_tokens is None for job in stage.runner.prepared)
