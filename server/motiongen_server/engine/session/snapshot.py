"""Takes snapshots of a session, and continues a session from one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from motiongen_server.engine.session.conditions import Conditions
from motiongen_server.engine.session.drift import Correction
from motiongen_server.engine.session.edits import PendingEdit
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.opening import Opening, open_session
from motiongen_server.engine.session.plan_log import PlanLog
from motiongen_server.engine.session.residuals import Residual, nearest_frame
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.session.timeline import Timeline, TokenRun
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.session.windows import history_crop
from motiongen_server.engine.types import (
    Constraint,
    Float32Array,
    GoingOn,
    HeldVelocity,
    ModelFacts,
    Open,
    SessionSnapshot,
    SnapshotTaken,
    UnansweredEdit,
)
from motiongen_server.engine.types.going_on import check_going_on, unusable


def news_of(state: SessionState) -> list[SnapshotTaken]:
    """A snapshot, if snapshots are on and the client was told of a plan or an answer that the last one lacks.

    None while a cut waits for its window: the frames that it continues from are in no snapshot; the client repeats the
    cut.
    """
    if state.cut is not None or (state.running is not None and state.running.cut is not None):
        return []
    if not state.config.snapshots or not state.plan or state.spec.is_clip:
        return []
    holds = state.plan, state.last_seq - len(_unanswered(state))
    if holds == state.saved:
        return []
    state.saved = holds
    return [SnapshotTaken(state.key, snapshot_of(state))]


def snapshot_of(state: SessionState) -> SessionSnapshot:
    """All of a session's state. The arrays are shared with the session, which never changes them."""
    delivery, conditions, timeline = state.delivery, state.conditions, state.timeline
    clock, velocity, drift = delivery.clock, conditions.velocity, state.drift_state
    # A client may lack frames from its last report on; the history of the next window may lie before that.
    needed_from = min(delivery.committed_to, delivery.sent_to, clock.reported) - history_crop(state.spec, state.config)
    first_frame = max(timeline.first, needed_from)
    return SessionSnapshot(
        spec=replace(state.spec, prompts=(), constraints=(), prior_rows=None, gaits=()),
        plan=state.plan,
        last_seq=state.last_seq,
        unanswered=tuple(
            UnansweredEdit(edit.event_seq, edit.kind, edit.dirty_from, edit.placements) for edit in _unanswered(state)
        ),
        prompts=conditions.prompts,
        constraints=conditions.constraints,
        velocity=None if velocity is None else _held(velocity),
        gait=conditions.gait,
        first_frame=first_frame,
        motion_from=max(timeline.motion_from, first_frame),
        rows=timeline.rows_between(first_frame, timeline.end),
        committed_to=delivery.committed_to,
        num_frames=delivery.num_frames,
        late_frames=delivery.late_frames,
        is_started=clock.started,
        play_state=clock.state,
        underruns=state.underruns,
        plans=delivery.plan_log.plans,
        measured_to=state.reach.measured_to,
        correction=int((state.running.correction if state.running else None) or drift.correction or 0),
        lost_from=drift.lost_from,
    )


def _unanswered(state: SessionState) -> tuple[PendingEdit, ...]:
    return (*(state.running.answers if state.running else ()), *state.edits.waiting)


def _held(velocity: Velocity) -> HeldVelocity:
    return HeldVelocity(velocity.x, velocity.z, velocity.heading, velocity.hold_frames, velocity.steers_from)


def check_usable(asked: GoingOn, facts: ModelFacts) -> None:
    """Raise EventRefused if the model, this engine, or the client cannot continue from a snapshot."""
    check_going_on(asked, facts)
    if asked.snapshot.correction not in (0, *Correction):
        raise unusable("its next window is to make a correction that is not known here")


def going_on(event: Open, asked: GoingOn, opening: Opening, features: Float32Array) -> SessionState:
    """The session of an Open that continues from a snapshot; the caller must apply the client's Resume next.

    features: (T, D), those of the snapshot's rows. Conditions include what unanswered edits asked for, and a plan will
    answer these.
    """
    held, facts, now = asked.snapshot, opening.facts, opening.now
    end = held.end_frame
    state = open_session(event.spec, event.received_at, opening)
    no_tokens = TokenRun(end, np.empty((0, facts.token_width), np.float32), facts.patch)
    begin = held.motion_from
    state.timeline = Timeline(held.first_frame, held.rows, features, no_tokens, begin, begin)
    velocity = held.velocity
    if velocity is not None:
        steered = Velocity(velocity.x, velocity.z, velocity.heading, velocity.hold_frames, velocity.steers_from)
    state.conditions = Conditions(held.prompts, held.constraints, None if velocity is None else steered, held.gait)
    state.plan, state.last_seq, state.underruns = held.plan, held.last_seq, held.underruns
    state.saved = held.plan, held.last_seq - len(held.unanswered)
    for edit in held.unanswered:
        waiting = PendingEdit(edit.event_seq, edit.kind, event.received_at, edit.dirty_from, edit.placements)
        state.edits.add(waiting)
    delivery = state.delivery
    delivery.sent_to = end
    delivery.promise(min(max(held.committed_to, asked.committed_to), end))
    delivery.num_frames, delivery.late_frames = held.num_frames, held.late_frames
    delivery.plan_log = PlanLog(held.plans)
    if held.is_started:
        delivery.clock.go_on(min(asked.playhead, end), now)
    delivery.clock.set_state(held.play_state, now, end)
    if held.correction:
        state.drift_state.correction, state.drift_state.lost_from = Correction(held.correction), held.lost_from
    state.reach.measured_to = held.measured_to
    begun = [each for each in held.constraints if each.first_frame < held.measured_to <= each.last_frame]
    posed = Posed(facts.rig, held.rows)
    state.reach.partial = [(each, _measured(each, held, posed)) for each in begun]
    state.reach.nearest = []
    for each in begun:
        first = max(each.first_frame, held.first_frame)
        if first < held.measured_to:
            part = posed.part(first - held.first_frame, held.measured_to - held.first_frame)
            state.reach.nearest.append((each, nearest_frame(each, first, part)))
    return state


def _measured(constraint: Constraint, held: SessionSnapshot, posed: Posed) -> Residual:
    """The errors so far of a constraint that has begun, as far as its frames are held. posed: all frames held."""
    residual = Residual()
    first = max(constraint.first_frame, held.first_frame)
    if first < held.measured_to:
        residual.add(constraint, first, posed.part(first - held.first_frame, held.measured_to - held.first_frame))
    return residual
