"""What an event changes in a session: at once, in the running window, or in the next one."""

from __future__ import annotations

import math
from collections.abc import Callable

from motiongen_server.engine.session.cutting import Cut, own_frames
from motiongen_server.engine.session.edits import SEEK, EditEvent, PendingEdit, edited
from motiongen_server.engine.session.placing import Anchor
from motiongen_server.engine.session.state import NOTHING_SAVED, SessionState, anchor_at
from motiongen_server.engine.session.windows import RunningWindow, history_crop, history_frames
from motiongen_server.engine.types import (
    Code,
    EventRefused,
    Float32Array,
    Outcome,
    Output,
    Playhead,
    Resume,
    SaveAgain,
    Seek,
    SetPlayState,
    SetPrompts,
)
from motiongen_server.engine.types.refusals import prior_frames_failed
from motiongen_server.engine.types.report import StepReport


def apply(
    state: SessionState, event: EditEvent | Playhead | SetPlayState | Resume | SaveAgain, now: float, report: StepReport
) -> list[Output]:
    """Apply an event. If this ends the running window (`running` becomes None), the caller must discard its job."""
    if isinstance(event, Playhead):
        _report_playhead(state, event, now, report)
        return []
    if isinstance(event, Resume):
        state.last_playhead_at = state.moved_at = now
        return state.delivery.resume(event, state.plan, state.timeline.first)
    if isinstance(event, SaveAgain):
        state.saved = NOTHING_SAVED
        return []
    if isinstance(event, SetPlayState):
        state.moved_at = now
        state.clock.set_state(event.state, event.received_at, state.delivery.sent_to)
        return [Outcome(state.key, event.event_seq, Code.OK)]
    try:
        return _edit(state, event, now, report)
    except EventRefused as refused:
        return [refused.outcome(state.key, event.event_seq)]


def _report_playhead(state: SessionState, event: Playhead, now: float, report: StepReport) -> None:
    if state.spec.clip_frames is not None:
        state.delivery.grant(min(event.frame, state.spec.clip_frames - state.spec.lookahead))
        return
    clock, reported = state.clock, state.clock.reported
    # At most one underrun per frame is believed, whatever the client reports.
    most = math.ceil((now - state.last_playhead_at) * state.facts.fps) + 1
    if event.underruns > state.underruns:
        report.client_underruns.append((state.spec.priority, min(event.underruns - state.underruns, most)))
        state.underruns = event.underruns
    state.delivery.report(event)
    state.last_playhead_at = now
    if clock.reported > reported:
        state.moved_at = now
    held = min(event.buffered_to, state.delivery.sent_to) - event.frame
    report.slacks.append((state.spec.priority, max(0, held) / state.facts.fps))


def _edit(state: SessionState, event: EditEvent, now: float, report: StepReport) -> list[Output]:
    state.edits.require_room()
    floor = state.replaceable_from(now, state.delivery.commit_s)
    crop = history_crop(state.spec, state.config)
    reach = state.facts.max_window_frames - history_frames(floor, state.timeline, crop, state.facts.patch)
    state.conditions, kind, dirty_from, placements, left_open, prolongs = edited(
        state.conditions,
        event,
        floor=floor,
        reach=reach,
        config=state.config,
        anchor=lambda: _anchor(state, now),
        gaits=state.spec.gaits,
    )
    state.edits.forget_replaced(state.conditions.constraints)
    if dirty_from is None:
        return [Outcome(state.key, event.event_seq, Code.OK, placements=placements)]
    if dirty_from > 0:
        dirty_from = max(dirty_from, state.timeline.motion_from + state.facts.patch)
    edit = PendingEdit(event.event_seq, kind, event.received_at, dirty_from, placements, left_open, prolongs)
    running = state.running
    if (
        running is not None
        and isinstance(event, SetPrompts)
        and running.first_frame < dirty_from < running.accept_to
        and dirty_from >= state.least_start(running)
    ):
        running.accept_to, running.answers = dirty_from, (*running.answers, edit)
        return []
    return _queue(state, edit, report)


def cut(
    state: SessionState,
    event: Seek,
    features_of: Callable[[Float32Array], Float32Array | None],
    now: float,
    report: StepReport,
) -> list[Output]:
    """Put the character elsewhere; otherwise as `apply`.

    features_of: makes features (H, D) of a client's rows, None if the model fails on them.
    """
    rows, features = event.prior_rows, None
    try:
        state.edits.require_room()
        if rows is not None:
            features = features_of(rows)
            if features is None:
                raise prior_frames_failed("seek.prior_frames")
        if event.frame:
            crop, patch = history_crop(state.spec, state.config), state.facts.patch
            rows, features = own_frames(state.timeline, event.frame, state.delivery.sent_to, crop, patch)
    except EventRefused as refused:
        return [refused.outcome(state.key, event.event_seq)]
    state.cut = Cut(event.start_pose, rows, features)
    edit = PendingEdit(event.event_seq, SEEK, event.received_at, state.replaceable_from(now, state.delivery.commit_s))
    return _queue(state, edit, report)


def _queue(state: SessionState, edit: PendingEdit, report: StepReport) -> list[Output]:
    """Have the next window answer an edit; restart the running one if that is worthwhile."""
    state.edits.add(edit)
    running = state.running
    if running is not None and edit.dirty_from < running.accept_to and _worth_restarting(state, running):
        state.restarts += running.steps_done > 0
        report.windows_restarted += running.steps_done > 0
        state.withdraw(running, report)
    return state.settle()


def _anchor(state: SessionState, now: float) -> Anchor:
    """Where the character will be when an edit made now takes effect, that is, where its window will probably start.

    A cut that was asked for earlier takes effect before it, so the character is then where the cut puts it.
    """
    frame = state.replaceable_from(now, max(state.predicted_s, state.extra_lead_s) + state.delivery.commit_s)
    running_cut = None if state.running is None else state.running.cut
    return anchor_at(state, frame, state.cut or running_cut)


def _worth_restarting(state: SessionState, running: RunningWindow) -> bool:
    """Whether to restart the running window for a new edit, rather than let another window follow it.

    A window that has not begun costs nothing. One that answers edits is finished: these came first, and more may come.
    """
    if not running.steps_done:
        return True
    early = running.steps_done * 2 < running.job.num_steps
    return early and not running.answers and state.restarts < state.config.max_restarts and not state.level.full_stride
