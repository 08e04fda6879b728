"""A snapshot holds all that another engine needs: nothing of a session is lost when it continues elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from motiongen_server.engine.session.cutting import own_frames
from motiongen_server.engine.session.drift import Correction
from motiongen_server.engine.session.opening import Opening
from motiongen_server.engine.session.snapshot import check_going_on, going_on, snapshot_of
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import (
    ConstraintReached,
    EventRefused,
    GoingOn,
    Open,
    Output,
    PlanCause,
    Playhead,
    RootTrajectory,
    SessionSnapshot,
    Span,
    StartPose,
    Waypoint,
)
from motiongen_server.snapshots.record import write_record
from tests.server.engine.fakes import FACTS, SPEED
from tests.server.engine.session.playing import playing_state
from tests.server.engine.session.test_snapshot import ELSEWHERE, SAVING, go_on
from tests.server.engine.stage import Stage, prompt
from tests.server.engine.viewer import Viewer
from tests.server.snapshots.records import a_record

METRES_A_FRAME = SPEED / 20


def restored(stage: Stage, viewer: Viewer, snapshot: SessionSnapshot) -> SessionState:
    """The session as another engine restores it, with its client at the same frame."""
    frame = stage.engine.sessions[viewer.key].clock.reported
    asked = GoingOn(snapshot, 1, snapshot.end_frame, snapshot.plan, frame, snapshot.committed_to)
    opening = Opening(3, FACTS, SAVING, now=7.0)
    event = Open(snapshot.spec, 1, 7.0, asked)
    return going_on(event, asked, opening, stage.runner.features(snapshot.rows))


def written(snapshot: SessionSnapshot) -> bytes:
    """The snapshot's record, with all that it holds."""
    return write_record(replace(a_record(), snapshot=snapshot))


def path(first: int, count: int, constraint_id: int = 1) -> RootTrajectory:
    """A trajectory along the fake runner's motion, except for one frame that lies 0.4 m beside it."""
    xz = np.zeros((count, 2), np.float32)
    xz[:, 0] = np.arange(first, first + count) * METRES_A_FRAME
    xz[2, 1] = 0.4
    return RootTrajectory(constraint_id, first, xz)


@pytest.mark.parametrize("paused", [False, True])
def test_snapshot_of_a_restored_session_equals_that_it_was_restored_from(paused: bool) -> None:
    stage, viewer, state = playing_state(SAVING)
    stage.set_constraints(viewer, path(viewer.committed_to + 20, 200))
    stage.run(2.0)
    state.underruns, state.delivery.late_frames = 3, 2
    stage.set_velocity(viewer, 0.5, 0.0, hold_frames=100)
    stage.run(1.0)
    stage.set_prompts(viewer, prompt(4, 2, start=viewer.buffered_to + 100))
    stage.pause(viewer, paused)
    stage.set_prompts(viewer, prompt(5))  # which no plan answers before the snapshot
    for seq in sorted(viewer.asked)[-2:]:
        stage.run_until(lambda seq=seq: state.last_seq >= seq)  # type: ignore[misc]
    before = snapshot_of(state)
    assert before.unanswered
    assert before.velocity is not None
    assert 0 < before.measured_to < before.constraints[0].last_frame
    again = restored(stage, viewer, before)
    assert written(replace(snapshot_of(again), lost_from=before.lost_from)) == written(before), "no character is lost"
    assert again.saved == (before.plan, before.last_seq - len(before.unanswered)), "nothing of it is new"
    assert again.replan_wanted


def test_pending_correction_survives_a_restore() -> None:
    stage, viewer, state = playing_state(SAVING)
    state.drift_state.correction, state.drift_state.lost_from = Correction.FRESH_START, 17
    again = restored(stage, viewer, snapshot_of(state))
    assert (again.drift_state.correction, again.drift_state.lost_from) == (Correction.FRESH_START, 17)


def told_of(outputs: list[Output]) -> dict[int, tuple[bool, int, int, float]]:
    """By constraint: whether it was met, its frame, how many frames were measured, and the worst distance."""
    return {
        each.constraint_id: (each.met, each.frame, each.num_frames, each.position_m.worst)
        for each in outputs
        if isinstance(each, ConstraintReached) and each.position_m is not None
    }


def test_constraints_begun_before_a_restore_are_reported_as_without_it() -> None:
    stage, viewer, state = playing_state(SAVING)
    begin = viewer.committed_to + 20
    nearest = begin + 4
    place = Waypoint(2, begin + 40, nearest * METRES_A_FRAME, 0.2, span=Span(begin, begin + 60))
    stage.set_constraints(viewer, path(begin, 60), place, path(begin + 2, 50, 3))
    stage.run_until(lambda: state.reach.measured_to > begin + 8)
    other, _ = go_on(snapshot_of(state), viewer)
    assert len(state.reach.partial) == 2
    stage.run(6.0)
    while (clock := other.engine.sessions[ELSEWHERE].clock).reported < begin + 80:
        frame = clock.reported + 4
        other.engine.submit(Playhead(ELSEWHERE, 0, other.clock.now(), frame, frame + 40, 0))
        other.run(0.2)
    told = told_of(stage.outputs)
    assert told_of(other.outputs) == told
    assert {number: (frame, frames) for number, (_, frame, frames, _) in told.items()} == {
        1: (begin + 59, 60),
        2: (nearest, 1),
        3: (begin + 51, 50),
    }
    assert all(worst == pytest.approx(0.2 if number == 2 else 0.4) for number, (*_, worst) in told.items())


def test_snapshot_holds_frames_its_client_may_lack_and_the_history_before() -> None:
    stage, viewer, state = playing_state(replace(SAVING, rewind_s=3.0))
    assert snapshot_of(state).first_frame == 0
    stage.run(8.0)
    held = snapshot_of(state)
    needed_from = min(state.clock.reported, state.delivery.committed_to)
    assert held.first_frame == needed_from - SAVING.history_crop > state.timeline.first
    assert held.end_frame == state.timeline.end
    assert held.motion_from == held.first_frame
    stage.seek(viewer, StartPose(3.0, 0.0))
    stage.run_until(lambda: viewer.notices[-1].cause is PlanCause.CUT)
    again = snapshot_of(state)
    assert again.motion_from == viewer.notices[-1].valid_from > again.first_frame, "no history spans the cut"
    there = restored(stage, viewer, again)
    assert there.timeline.motion_from == again.motion_from
    assert again.end_frame > again.motion_from + FACTS.patch
    with pytest.raises(EventRefused) as refused:
        own_frames(there.timeline, again.motion_from - 1, there.delivery.sent_to, 16, FACTS.patch)
    assert refused.value.allowed == f"frames {again.motion_from + FACTS.patch} to {again.end_frame}"


def test_snapshot_carries_the_correction_of_a_running_window() -> None:
    stage, _, state = playing_state(SAVING)
    stage.run_until(lambda: state.running is not None)
    assert state.running is not None
    for correction in (None, Correction.SHORT_HISTORY, Correction.FRESH_START):
        state.running.correction = correction
        assert snapshot_of(state).correction == (correction or 0)


def test_restored_constraint_has_begun_while_it_is_partly_measured() -> None:
    stage, viewer, state = playing_state(SAVING)
    asked = path(viewer.committed_to + 20, 20)
    stage.set_constraints(viewer, asked)
    stage.run_until(lambda: state.reach.measured_to > asked.first_frame)
    snapshot = snapshot_of(state)
    for measured_to, num_frames in ((0, []), (1, [1]), (19, [19]), (20, [])):
        seen = replace(snapshot, measured_to=asked.first_frame + measured_to)
        begun = restored(stage, viewer, seen).reach.partial
        assert [residual.num_frames for _, residual in begun] == num_frames


def test_client_may_be_at_any_held_frame_or_the_next_if_there_is_a_history() -> None:
    _, _, state = playing_state(SAVING)
    all_of_it = snapshot_of(state)
    end = all_of_it.end_frame

    def refusal_of(num_frames: int, next_frame: int) -> str:
        first = end - num_frames
        rows = all_of_it.rows[first - all_of_it.first_frame :]
        held = replace(all_of_it, first_frame=first, rows=rows)
        try:
            check_going_on(GoingOn(held, 1, next_frame, held.plan, next_frame, next_frame), FACTS)
        except EventRefused as refused:
            return refused.reason
        return ""

    no = "SNAPSHOT_UNUSABLE"
    assert [refusal_of(10, end + away) for away in (-11, -10, 0, 1)] == [no, "", "", no]
    assert [refusal_of(FACTS.patch - less, end) for less in (0, 1)] == ["", no]
