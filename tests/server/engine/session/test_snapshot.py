"""Snapshots: taken when a client was told something new, and used to continue a session in another engine."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.session.drift import Correction
from motiongen_server.engine.types import (
    VELOCITY_ID,
    Chunk,
    Code,
    Direction,
    Gait,
    GoingOn,
    HeldVelocity,
    Open,
    Opened,
    Outcome,
    Output,
    PlanCause,
    PlanNotice,
    PlayState,
    Resumed,
    SaveAgain,
    SessionKey,
    SessionSnapshot,
    SnapshotTaken,
    Waypoint,
    WindowJob,
)
from motiongen_server.snapshots.record import read_record, write_record
from tests.server.engine.fakes import FACTS, FRAME, PROMPT
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer
from tests.server.snapshots.records import a_record

SAVING = EngineConfig(snapshots=True)
ELSEWHERE = SessionKey(9, 4)
WALK = Gait("walk", "a person walks", 0.0, Direction.FORWARD, np.array([4, 0], np.float32))


def snapshots(stage: Stage) -> list[SessionSnapshot]:
    return [output.snapshot for output in stage.outputs if isinstance(output, SnapshotTaken)]


def through_a_store(snapshot: SessionSnapshot) -> SessionSnapshot:
    return read_record(write_record(replace(a_record(), snapshot=snapshot))).snapshot


def go_on(snapshot: SessionSnapshot, viewer: Viewer, **where: int) -> tuple[Stage, list[Output]]:
    """Another engine that continues from a snapshot, and its first outputs for a client at the viewer's position."""
    asked = GoingOn(snapshot, 1, len(viewer.rows), viewer.notices[-1].plan, int(viewer.position), viewer.committed_to)
    stage = Stage(SAVING)
    other = Viewer(ELSEWHERE, viewer.lookahead, viewer.fps)
    stage.viewers[ELSEWHERE] = other
    other.take = lambda output, now: None  # type: ignore[method-assign]  # its checks apply to sessions from frame 0 on
    stage.silent.add(ELSEWHERE)
    stage.next_report_at[ELSEWHERE] = 0.0
    spec = replace(snapshot.spec, session=ELSEWHERE)
    stage.engine.submit(Open(spec, 1, stage.clock.now(), replace(asked, **where)))
    stage.run(1.0)
    return stage, stage.outputs


def test_no_snapshot_is_taken_unless_configured_nor_of_a_clip() -> None:
    stage = Stage()
    stage.open()
    stage.run(3.0)
    assert not snapshots(stage)
    saving = Stage(SAVING)
    saving.open_clip(1, 80)
    saving.run(3.0)
    assert not snapshots(saving)


def test_snapshot_follows_each_plan_and_each_outcome_and_nothing_else() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(3.0)
    before = len(snapshots(stage))
    assert [each.plan for each in snapshots(stage)] == [each.plan for each in viewer.notices]
    stage.pause(viewer, True)
    stage.step()
    assert len(snapshots(stage)) == before + 1
    assert snapshots(stage)[-1].play_state is PlayState.PAUSED
    stage.run(5.0)
    told = [type(output) for output in stage.outputs if isinstance(output, PlanNotice | SnapshotTaken | Outcome)]
    assert told.count(SnapshotTaken) <= told.count(PlanNotice) + told.count(Outcome)
    last = len(snapshots(stage))
    stage.run(5.0)
    assert len(snapshots(stage)) == last, "nothing happens to a session that is paused and full"


def test_save_again_takes_a_snapshot_of_a_paused_session_but_not_of_a_clip() -> None:
    stage = Stage(SAVING)
    viewer, clip = stage.open(prompts=(prompt(1),)), stage.open_clip(2, 80)
    stage.run(3.0)
    stage.pause(viewer, True)
    stage.run(5.0)
    stage.outputs.clear()
    for key in (viewer.key, clip.key, ELSEWHERE):
        stage.engine.submit(SaveAgain(key, 0, stage.clock.now()))
    stage.run(5.0)
    (snapshot,) = snapshots(stage)
    assert snapshot.plan == viewer.notices[-1].plan
    assert snapshot.play_state is PlayState.PAUSED
    assert not any(isinstance(output, Outcome) for output in stage.outputs)


def test_another_engine_continues_frames_without_a_gap_and_with_what_was_asked_for() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    stage.set_prompts(viewer, prompt(3, 2, start=90))
    stage.set_constraints(viewer, Waypoint(1, 120, 1.0, 1.0))
    stage.run(1.0)
    snapshot = through_a_store(snapshots(stage)[-1])
    assert snapshot.plan == viewer.notices[-1].plan
    other, said = go_on(snapshot, viewer)
    assert isinstance(said[0], Opened)
    resumed = next(output for output in said if isinstance(output, Resumed))
    assert resumed == Resumed(ELSEWHERE, 1, len(viewer.rows), None)
    first = next(output for output in said if isinstance(output, Chunk))
    assert first.first_frame == len(viewer.rows)
    assert first.plan >= snapshot.plan
    rows = [row for output in said if isinstance(output, Chunk) for row in output.rows]
    end = len(viewer.rows) + len(rows)
    assert [row[FRAME] for row in rows] == list(range(len(viewer.rows), end))
    assert [row[PROMPT] for row in rows] == [1] * (90 - len(viewer.rows)) + [3] * (end - 90)
    jobs = other.runner.prepared
    assert all(job.seed == snapshot.spec.seed and job.plan > snapshot.plan for job in jobs)
    assert [job.constraints for job in jobs] == [(Waypoint(1, 120, 1.0, 1.0),)] * 2
    assert other.runner.breaches == []


def test_continued_session_does_not_count_as_one_that_is_beginning() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    other, _ = go_on(snapshots(stage)[-1], viewer)
    other.run(5.0)
    assert other.engine.num_sessions == 1
    assert other.engine.admission.num_beginning == 0


def test_unanswered_edit_is_answered_by_the_other_engine() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    stage.pause(viewer, True)
    seq = stage.set_prompts(viewer, prompt(5))
    stage.pause(viewer, False)  # which is answered at once, so that the session is saved with an unanswered edit
    stage.step()
    snapshot = through_a_store(snapshots(stage)[-1])
    assert [edit.event_seq for edit in snapshot.unanswered] == [seq]
    assert snapshot.last_seq == seq + 1
    _, said = go_on(snapshot, viewer)
    (answer,) = [output for output in said if isinstance(output, Outcome)]
    assert (answer.event_seq, answer.code) == (seq, Code.OK)
    notice = next(output for output in said if isinstance(output, PlanNotice))
    assert notice.event_seqs == (seq,)
    chunk = next(output for output in said if isinstance(output, Chunk) and output.plan == notice.plan)
    assert chunk.rows[0][PROMPT] == 5


def test_client_that_missed_a_plan_is_told_of_it_when_resuming_elsewhere() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    plan, held = viewer.notices[-1].plan, len(viewer.rows)
    stage.set_prompts(viewer, prompt(2))
    stage.run(0.5)
    snapshot = snapshots(stage)[-1]
    assert snapshot.plan > plan
    _, said = go_on(snapshot, viewer, plan=plan, next_frame=held)
    resumed = next(output for output in said if isinstance(output, Resumed))
    assert resumed.notice is not None
    assert resumed.notice.cause is PlanCause.RESUME
    assert resumed.start_frame == resumed.notice.valid_from
    assert resumed.notice.valid_from >= 0


def test_committed_frames_and_playhead_are_taken_over_by_the_other_engine() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    end = len(viewer.rows)
    other, _ = go_on(snapshots(stage)[-1], viewer, committed_to=end, playhead=end - 5)
    state = other.engine.sessions[ELSEWHERE]
    assert state.delivery.committed_to >= end
    assert state.clock.reported == end - 5


@pytest.mark.parametrize("where", [{"plan": 99}, {"next_frame": 100_000}])
def test_client_that_is_ahead_of_the_snapshot_is_refused(where: dict[str, int]) -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    other, said = go_on(snapshots(stage)[-1], viewer, **where)
    (refusal,) = said
    assert isinstance(refusal, Outcome)
    assert (refusal.event_seq, refusal.reason) == (1, "SNAPSHOT_UNUSABLE")
    assert other.engine.num_sessions == 0


SPOILT = ["model", "width", "nan", "short", "prompt", "gait", "steps", "look-ahead", "history", "outputs"]


@pytest.mark.parametrize("spoilt", SPOILT)
def test_snapshot_that_does_not_fit_the_model_is_refused(spoilt: str) -> None:
    """If only the model found out that it does not fit, the engine would end, and all other sessions with it."""
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(2.0)
    snapshot = snapshots(stage)[-1]
    spec, wide = snapshot.spec, np.zeros(FACTS.embedding_dim + 1, np.float32)
    gait = Gait("walk", "a person walks", 0.5, Direction.FORWARD, wide)
    rows = snapshot.rows.copy()
    rows[3, 1] = np.nan
    spoils = {
        "model": replace(snapshot, spec=replace(snapshot.spec, model_id="another")),
        "width": replace(snapshot, rows=snapshot.rows[:, :-1]),
        "nan": replace(snapshot, rows=rows),
        "short": replace(snapshot, rows=snapshot.rows[: FACTS.patch - 1]),
        "prompt": replace(snapshot, prompts=(replace(snapshot.prompts[0], embedding=wide),)),
        "gait": replace(snapshot, gait=gait),
        "steps": replace(snapshot, spec=replace(spec, denoise_steps=FACTS.max_steps + 1)),
        "look-ahead": replace(snapshot, spec=replace(spec, lookahead=FACTS.horizon - 1)),
        "history": replace(snapshot, spec=replace(spec, history_frames=FACTS.patch + 1)),
        "outputs": replace(snapshot, spec=replace(spec, outputs=("muscles",))),
    }
    other, said = go_on(spoils[spoilt], viewer)
    assert [output.reason for output in said if isinstance(output, Outcome)] == ["SNAPSHOT_UNUSABLE"]
    assert other.engine.num_sessions == 0


def test_lost_character_is_corrected_by_the_other_engine() -> None:
    stage = Stage(SAVING)
    stage.runner.rights = True

    def move(job: WindowJob, frames: np.ndarray) -> None:
        if job.plan == 3:
            frames[:, 1] = 9.0

    stage.runner.moves = move
    viewer = stage.open(prompts=(prompt(1),))
    stage.run_until(lambda: bool(viewer.notices) and viewer.notices[-1].plan == 3)
    held = through_a_store(snapshots(stage)[-1])
    assert held.correction == Correction.FRESH_START
    other, _ = go_on(held, viewer)
    assert other.runner.prepared[0].cause is PlanCause.FALLBACK


def test_snapshot_with_an_unknown_correction_is_refused() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),))
    stage.run(3.0)
    _, outputs = go_on(replace(snapshots(stage)[-1], correction=7), viewer)
    (refused,) = (output for output in outputs if isinstance(output, Outcome))
    assert refused.reason == "SNAPSHOT_UNUSABLE"


def test_velocity_continues_in_the_other_engine_with_its_gait_and_end() -> None:
    stage = Stage(SAVING)
    viewer = stage.open(prompts=(prompt(1),), gaits=(WALK,))
    stage.run(2.0)
    stage.set_velocity(viewer, 1.0, 0.5, heading=0.25, hold_frames=200)
    stage.run(0.5)
    velocity = stage.engine.sessions[viewer.key].conditions.velocity
    assert velocity is not None
    held = through_a_store(snapshots(stage)[-1]).velocity
    assert held == HeldVelocity(1.0, 0.5, 0.25, 200, velocity.steers_from)
    other, _ = go_on(through_a_store(snapshots(stage)[-1]), viewer)
    conditions = other.engine.sessions[ELSEWHERE].conditions
    assert conditions.velocity is not None
    assert conditions.velocity.leads_as(velocity)
    assert conditions.velocity.end_if_from(0) == velocity.end_if_from(0)
    job = other.runner.prepared[0]
    assert [each.constraint_id for each in job.constraints] == [VELOCITY_ID]
    assert job.embedding is not None
    assert job.embedding[0] == 4
