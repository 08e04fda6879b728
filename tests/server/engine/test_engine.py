"""The engine: sessions are opened, closed, refused, and served side by side."""

from collections import Counter
from collections.abc import Sequence

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import (
    Close,
    CloseReason,
    Code,
    Open,
    Output,
    Priority,
    SessionKey,
    SetPrompts,
)
from tests.server.engine.fakes import PROMPT, SEED
from tests.server.engine.stage import Stage, crowd, prompt, spec
from tests.server.engine.viewer import Viewer


def test_sessions_share_denoising_steps_and_keep_their_own_motion() -> None:
    stage, viewers = crowd(8)
    stage.run(5.0)
    assert max(len(batch) for batch in stage.runner.batches) == 8
    for viewer in viewers:
        assert {int(row[SEED]) for row in viewer.rows} == {viewer.key.handle}
        assert viewer.underruns == 0
    stage.check_finished()


def test_windows_of_sessions_opened_together_spread_over_time() -> None:
    stage, viewers = crowd(60)
    stage.run(20.0)
    begun = Counter(int(job.created_at / 0.25) for job in stage.runner.prepared if job.created_at > 110.0)
    a_window_lasts = 40 / 20
    assert max(begun.values()) <= 2.5 * len(viewers) * 0.25 / a_window_lasts
    assert all(viewer.underruns == 0 for viewer in viewers)


def test_full_engine_refuses_opens_at_once_and_admits_again_after_a_close() -> None:
    stage, viewers = crowd(3, EngineConfig(max_sessions=2))
    stage.step()
    refused = viewers[2].refused
    assert refused is not None
    assert (refused.code, refused.reason) == (Code.RESOURCE_EXHAUSTED, "SESSION_LIMIT")
    assert "2" in refused.allowed
    assert refused.field == "open"
    assert refused.retry_after_s is not None
    assert 2.0 <= refused.retry_after_s <= 4.0
    assert sorted(stage.reports[0].opens) == [Code.OK, Code.OK, Code.RESOURCE_EXHAUSTED]
    stage.close(viewers[0])
    again = stage.open(4)
    stage.run(1.0)
    assert again.opened is not None
    assert stage.engine.num_sessions == 2


def test_open_with_a_handle_in_use_is_refused_and_its_session_continues() -> None:
    stage, (viewer,) = crowd(1)
    stage.run(0.5)
    seq = 99
    viewer.asked.add(seq)
    stage.engine.submit(Open(spec(viewer.key), seq, stage.clock.now()))
    stage.run(5.0)
    assert (viewer.outcomes[seq].code, viewer.outcomes[seq].reason) == (Code.ALREADY_EXISTS, "HANDLE_IN_USE")
    assert viewer.shown > 90


def test_events_for_a_session_that_is_not_open_are_answered() -> None:
    stage, (viewer,) = crowd(1)
    stage.run(0.5)
    stage.close(viewer)
    stage.step()
    late = Viewer(viewer.key, 40, 20)
    stage.viewers[viewer.key] = late
    stage.engine.submit(SetPrompts(viewer.key, 5, stage.clock.now(), (prompt(1),)))
    stage.engine.submit(late.lie(3, stage.clock.now()))
    stage.step()
    assert late.refused is not None
    assert (late.refused.code, late.refused.reason) == (Code.NOT_FOUND, "SESSION_NOT_OPEN")
    stage.engine.submit(Close(SessionKey(9, 9), 5, stage.clock.now()))
    stage.viewers[SessionKey(9, 9)] = other = Viewer(SessionKey(9, 9), 40, 20)
    stage.step()
    assert other.refused is not None


def test_close_answers_waiting_edits_as_cancelled() -> None:
    stage, (viewer,) = crowd(1)
    stage.run(1.0)
    seq = stage.set_prompts(viewer, prompt(2))
    stage.step()
    waiting = stage.set_prompts(viewer, prompt(3))
    stage.close(viewer)
    stage.step()
    assert [viewer.outcomes[n].code for n in (seq, waiting)] == [Code.CANCELLED, Code.CANCELLED]
    assert viewer.closed is not None
    assert (viewer.closed.reason, viewer.closed.code) == (CloseReason.CLIENT, Code.OK)
    assert stage.runner.jobs == {}


def test_reused_handle_gets_no_frames_of_its_previous_session() -> None:
    stage, (old,) = crowd(1, prompts=(prompt(1),))
    stage.step()
    assert len(stage.runner.jobs) == 1
    stage.engine.submit(old.lie(7, stage.clock.now()))
    stage.close(old)
    new_stage_viewer = Viewer(old.key, 40, 20)
    seen: list[Output] = []

    def deliver(outputs: Sequence[Output]) -> None:
        for output in outputs:
            viewer = old if old.closed is None else new_stage_viewer
            viewer.take(output, stage.clock.now())
            seen.append(output)

    stage.deliver = deliver  # type: ignore[method-assign]
    stage.engine.submit(Open(spec(old.key, seed=500, prompts=(prompt(2),)), 1, stage.clock.now()))
    for _ in range(8):
        stage.step()
    assert old.closed is not None
    assert {int(row[PROMPT]) for row in new_stage_viewer.rows} == {2}
    assert {int(row[SEED]) for row in new_stage_viewer.rows} == {500}
    assert len(new_stage_viewer.rows) == 40
    assert stage.runner.breaches == []


def test_a_silent_session_is_closed_as_idle_and_a_reporting_one_is_not() -> None:
    stage, (talker, silent) = crowd(2, EngineConfig(idle_timeout_s=5.0))
    stage.silent.add(silent.key)
    stage.run(7.0)
    assert silent.closed is not None
    assert silent.closed.reason is CloseReason.IDLE
    assert talker.closed is None


def test_edits_beyond_max_pending_events_are_refused_on_submission() -> None:
    stage, (viewer,) = crowd(1, EngineConfig(max_pending_events=3))
    stage.run(0.5)
    seqs = [stage.set_prompts(viewer, prompt(n)) for n in range(5)]
    assert [viewer.outcomes[seq].reason for seq in seqs[3:]] == ["TOO_MANY_PENDING_EVENTS"] * 2
    stage.run(1.0)
    assert viewer.rows[-1][PROMPT] == 2
    stage.check_finished()


def test_overload_causes_underruns_for_crowd_sessions_but_not_for_heroes() -> None:
    stage = Stage(EngineConfig(max_rows=4))
    stage.runner.step_s = lambda rows: 0.06
    heroes = [stage.open(handle, priority=Priority.HERO) for handle in range(1, 4)]
    crowd = [stage.open(handle, priority=Priority.CROWD) for handle in range(10, 40)]
    stage.run(20.0)
    assert sum(viewer.underruns for viewer in heroes) == 0
    assert all(viewer.buffered_to >= 40 for viewer in crowd)
    assert sum(viewer.underruns for viewer in crowd) > 0
