"""Emission: what a session sends: frames as far as its credit allows, results of constraints, a held pose."""

from __future__ import annotations

import math

from motiongen_server.engine.session.further_blocks import MakeOutputs, with_outputs
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.session.windows import history_crop
from motiongen_server.engine.types import (
    Output,
    PlanCause,
    PlanNotice,
)
from motiongen_server.engine.types.report import EventLatency, StepReport


def emit(state: SessionState, now: float, report: StepReport, outputs_of: MakeOutputs) -> list[Output]:
    """Send what the credit allows. outputs_of: makes further blocks of frames. Raises OutputsFailed."""
    outputs: list[Output] = _hold(state, now, report) if state.level.hold else []
    if state.spec.is_clip:
        state.delivery.promise(state.planned_to)
    # The running window may still land where it starts; promising frames beyond that would make it useless.
    promise_to = math.inf if state.running is None else state.running.first_frame
    if state.delivery.waits(now, state.planned_to):
        promise = state.delivery.promised(now, state.planned_to, promise_to)
        if not state.reach.is_due(state.conditions, promise):
            return outputs
    sent_before = state.delivery.sent_to
    opening = state.delivery.num_frames == 0
    chunks = state.delivery.chunks(now, state.timeline, state.plan, promise_to)
    if not chunks:
        return outputs
    if state.spec.outputs:
        chunks = [with_outputs(chunk, state.spec.outputs, state.timeline, outputs_of) for chunk in chunks]
    outputs += chunks
    told = state.reach.reached(state.facts.rig, state.conditions, state.timeline, state.delivery.committed_to)
    if told:
        state.conditions = state.conditions.without_told([constraint for constraint, _ in told])
        outputs += [reached for _, reached in told]
    report.frames_sent += state.delivery.sent_to - sent_before
    if opening:
        report.event_latencies.append(EventLatency(state.spec.priority, "open", now - state.opened_at))
    for edit in state.edits.seen(state.delivery.sent_to):
        report.event_latencies.append(EventLatency(state.spec.priority, edit.kind, now - edit.received_at))
    _trim(state)
    return outputs


def _hold(state: SessionState, now: float, report: StepReport) -> list[Output]:
    """Repeat the last pose if the client would run out of frames and no window may be made for it."""
    held_from, delivery = state.planned_to, state.delivery
    if state.running is not None or held_from == 0 or not state.clock.running:
        return []
    if not delivery.runs_low(now, held_from, delivery.commit_frames):
        return []
    state.timeline = state.timeline.held(state.config.hold_frames)
    delivery.promise(state.planned_to)
    report.frames_held += state.config.hold_frames
    if state.holding:
        return []
    state.plan += 1
    state.holding = True
    notice = PlanNotice(state.key, state.plan, held_from, PlanCause.FALLBACK, ())
    delivery.plan_log.note(notice, delivery.sent_to)
    return [notice]


def _trim(state: SessionState) -> None:
    """Drop frames that can no longer be sent, replaced, in a history or rewound to; and conditions that are over."""
    committed_to = state.delivery.committed_to
    # A client that loses its connection may need everything beyond its last report again.
    missed_from = math.inf if state.spec.is_clip else state.clock.reported
    rewind_frames = 0 if state.spec.is_clip else math.ceil(state.config.rewind_s * state.facts.fps)
    needed_from = int(min(committed_to, state.delivery.sent_to, missed_from)) - history_crop(state.spec, state.config)
    keep_from = needed_from - rewind_frames
    if keep_from - state.timeline.first >= state.facts.horizon:
        state.timeline = state.timeline.trimmed(keep_from)
    state.conditions = state.conditions.without_past(committed_to)
