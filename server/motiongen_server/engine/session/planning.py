"""Planning: which window a session needs next and when, and what becomes of a finished one."""

from __future__ import annotations

import math
from dataclasses import replace

from motiongen_server.engine.session.kinematics import continued
from motiongen_server.engine.session.placing_anew import placed_anew
from motiongen_server.engine.session.state import SessionState, anchor_at
from motiongen_server.engine.session.windows import Due, RunningWindow, WindowSite
from motiongen_server.engine.types import (
    Output,
    PlanCause,
    PlanNotice,
    WindowJob,
    WindowResult,
)
from motiongen_server.engine.types.report import StepReport

_REST_SHARE = 1.3
"""The least time from one replan's edit to a session's next replan, which gives others a turn.

As a multiple of the time that the first one is expected to take.
"""
_LEAST_PROLONGING_S = 0.25
"""The least time planned for a window that prolongs a velocity, however quick windows are."""
_MOST_WAIT_S = 0.5
"""The longest wait for the answer to an edit that only prolongs a velocity."""


def wake_at(state: SessionState) -> float:
    """When the session must be looked at if no event comes before; infinity: not because of time alone."""
    if state.running is not None or state.spec.is_clip:
        return math.inf
    planned_to, delivery = state.timeline.end, state.delivery
    if state.level.hold and planned_to:
        return delivery.reaches_at(planned_to - delivery.commit_frames)
    wake_at = delivery.reaches_at(planned_to - state.continue_threshold - delivery.far_frames)
    return min(wake_at, _replan_at(state)) if state.replan_wanted else wake_at


def window_due(state: SessionState, now: float) -> bool:
    """Whether to start a window: for an edit, or because the client will soon have played all frames."""
    if state.running is not None:
        return False
    planned_to = state.timeline.end
    if state.spec.clip_frames is not None:
        room_to = min(state.spec.clip_frames, state.clock.credited + state.spec.lookahead)
        return planned_to < room_to and now >= state.edits.not_before
    if planned_to == 0:
        return True
    if state.level.hold:
        return False
    delivery = state.delivery
    enough = state.continue_threshold + delivery.far_frames
    if delivery.runs_low(now, planned_to, enough):
        return True
    return state.replan_wanted and now >= _replan_at(state)


def _replan_at(state: SessionState) -> float:
    """When a window may start for the edits or the correction that wait; one of these must.

    A client that keeps a velocity up repeats it long before it ends. Until the playhead comes near that end, the plan
    is already what was asked for, and a window for each repetition would be shown only until the next.
    """
    edits, delivery = state.edits, state.delivery
    if state.drift_state.lost or not state.clock.running or not edits.only_prolong:
        return edits.not_before
    first = min(edits.waiting, key=lambda edit: edit.dirty_from)
    lead_s = delivery.commit_s + max(2 * state.predicted_s, state.extra_lead_s, _LEAST_PROLONGING_S)
    nears_at = delivery.reaches_at(first.dirty_from - math.ceil(state.facts.fps * lead_s))
    return max(edits.not_before, min(nears_at, first.received_at + _MOST_WAIT_S))


def num_steps_due(state: SessionState, now: float) -> int:
    """The denoising steps of the window that is due."""
    if not state.edits.waiting:
        return state.num_steps
    return state.num_replan_steps(state.replaceable_from(now, state.delivery.commit_s))


def next_window(state: SessionState, now: float, predicted_s: float, job_id: int) -> WindowJob:
    """Start the window that is due. predicted_s: how long it will take from now."""
    assert window_due(state, now)
    first_frame, cause = _next_start(state, now, predicted_s)
    due = Due(job_id, num_steps_due(state, now), now, deadline(state, now), runs_out_at(state, now))
    if state.replan_wanted and not state.spec.is_clip:
        replans_hz = state.config.replans_hz[state.spec.priority - 1] * state.level.replan_cap_scale
        state.edits.space_replans(now, 1.0 / replans_hz, _REST_SHARE * predicted_s)
    state.predicted_s = predicted_s
    return _begin(state, first_frame, cause, due)


def begin_elsewhere(state: SessionState, now: float, predicted_s: float) -> WindowJob | None:
    """Move the running window to another first frame, if that is better now that its duration is known.

    For windows of edits, before their first step. One that would come too late starts later, and one that can come at
    least a patch earlier starts earlier. None if it stays as it is.
    """
    running = state.running
    assert running is not None
    assert not running.steps_done
    if not running.answers:
        return None
    job, waiting = running.job, state.edits.waiting
    state.edits.waiting = (*running.answers, *waiting)
    first_frame, cause = _next_start(state, now, predicted_s)
    if 0 <= running.first_frame - first_frame < state.facts.patch:
        state.edits.waiting = waiting
        return None
    state.running, state.cut = None, state.cut or running.cut
    state.drift_state.correction = running.correction
    state.predicted_s = predicted_s
    due = Due(job.job_id, job.num_steps, job.created_at, job.deadline, job.runs_out_at)
    return _begin(state, first_frame, cause, due)


def _begin(state: SessionState, first_frame: int, cause: PlanCause, due: Due) -> WindowJob:
    """Start a window from first_frame on, for all edits that wait."""
    if state.edits.are_left_open:
        _place_anew(state, first_frame)
    cut, spec, timeline = state.cut, state.spec, state.timeline
    if cut is not None:
        cause, spec = PlanCause.CUT, replace(spec, start_pose=cut.start_pose)
        timeline, state.drift_state.correction = cut.timeline_at(first_frame, state.facts), None
    site = WindowSite(spec, state.facts, state.config, state.drift_state.guard, state.level, state.conditions, timeline)
    job = site.job(first_frame, state.drift_state.correction_from(first_frame), state.plan + 1, cause, due)
    end = first_frame + state.facts.horizon
    if cause is PlanCause.CONTINUE and state.clock.running:
        end, state.cut_frames = end - state.cut_frames, 0
    state.running = RunningWindow(
        job, end, state.edits.take(), state.conditions.velocity, state.drift_state.correction, state.facts.fps
    )
    state.running.cut, state.cut = cut, None
    change = state.conditions.prompt_change_after(first_frame, end)
    state.running.accept_to = max(change, state.least_start(state.running))
    state.drift_state.correction = None
    return job


def _place_anew(state: SessionState, first_frame: int) -> None:
    """Place left-open constraints of waiting edits again, from where a window from first_frame on finds the character.

    Those after a cut that waits too are placed from where the cut puts the character. Those between two cuts were
    placed from where the first one would have put it, and stay there.
    """
    before, between, behind = state.edits.apart_by_cuts()
    conditions, before = placed_anew(state.conditions, before, anchor_at(state, first_frame))
    if behind:
        conditions, behind = placed_anew(conditions, behind, anchor_at(state, first_frame, state.cut))
    state.conditions, state.edits.waiting = conditions, (*before, *between, *behind)


def _next_start(state: SessionState, now: float, predicted_s: float) -> tuple[int, PlanCause]:
    """The first frame of the window that is due, and why it is made."""
    planned_to = state.planned_to
    if planned_to == 0 or not state.replan_wanted:
        return planned_to, PlanCause.CONTINUE if state.drift_state.correction is None else PlanCause.FALLBACK
    lead_s = max(predicted_s, state.extra_lead_s) + state.delivery.commit_s
    earliest = state.replaceable_from(now, lead_s)
    wanted = min((edit.dirty_from for edit in state.edits.waiting), default=earliest)
    grid, patch = state.timeline.run.first, state.facts.patch
    if wanted > earliest:
        on_grid = wanted - (wanted - grid) % patch
        goes_on_sooner = state.edits.only_prolong and on_grid >= earliest
        return min(on_grid if goes_on_sooner else wanted, planned_to), PlanCause.EDIT
    if state.cut is None and earliest - state.replanned_from < state.config.align_within:
        # Characters glide if plans that are replaced after a few frames each begin anywhere: their histories are parts
        # of tokens then, encoded again and again.
        on_grid = min(earliest + (grid - earliest) % patch, planned_to)
        if not state.conditions.ends_within(earliest, on_grid):
            earliest = on_grid
    return earliest, PlanCause.EDIT if state.edits.waiting else PlanCause.FALLBACK


def deadline(state: SessionState, now: float) -> float:
    """When the window that is due must be done.

    That is its class target after its edit may be answered, or before the client runs out of frames.
    """
    if state.spec.is_clip:
        return state.opened_at + state.config.clip_target_s
    if state.planned_to == 0:
        return state.opened_at + state.config.open_target_s
    if state.edits.waiting:
        asked_at = max(min(edit.received_at for edit in state.edits.waiting), _replan_at(state))
        return asked_at + state.config.target_s(state.spec.priority)
    return _planned_until(state, now)


def runs_out_at(state: SessionState, now: float) -> float:
    """When the window's frames must be there for the client not to run out of frames, whatever the window is for.

    A client without any frames counts as one that runs out of them some time after its open.
    """
    if state.spec.is_clip:
        return math.inf
    if state.planned_to == 0:
        return state.opened_at + state.config.open_limit_s
    return _planned_until(state, now) if state.clock.running else math.inf


def _planned_until(state: SessionState, now: float) -> float:
    unplayed = state.delivery.unplayed_at_pace(now, state.planned_to)
    return now + unplayed / state.facts.fps - state.delivery.delivery_s


def accept(state: SessionState, result: WindowResult, now: float, report: StepReport) -> list[Output]:
    """Append the finished running window to the plan, or discard it if it came too late."""
    running = state.running
    assert running is not None
    assert running.job.job_id == result.job_id
    _note_deadline(state, running, now, report)
    if running.first_frame < state.replaceable_from(now, state.delivery.delivery_s):
        state.withdraw(running, report)
        state.extra_lead_s = max(now - running.job.created_at, 2 * state.extra_lead_s)
        report.windows_discarded += 1
        return []
    state.running = None
    first_frame, num_frames = running.first_frame, running.accept_to - running.first_frame
    # A runner may return fewer frames, if from the next one on the model is to be told something else.
    rows = result.frames[:num_frames]
    if len(rows) and first_frame > state.timeline.first:
        rows = continued(state.facts.rig, rows, state.timeline.rows_between(first_frame - 1, first_frame)[0])
    state.timeline = state.timeline.spliced(
        first_frame, rows, result.features[:num_frames], result.tokens, anew=running.fresh
    )
    state.plan += 1
    state.holding = False
    state.restarts, state.extra_lead_s = 0, 0.0
    before = state.timeline.made_before(first_frame, state.facts.longest_flight)
    state.drift_state.judge(rows, first_frame, before, again=running.correction is not None)
    state.conditions = state.conditions.with_velocity_landed(running.velocity, first_frame)
    state.delivery.first_chunk_due |= running.job.cause in (PlanCause.EDIT, PlanCause.CUT)
    if not all(edit.prolongs for edit in running.answers):
        state.replanned_from = first_frame
    report.windows.append((state.spec.priority, running.job.cause))
    report.soft_resets += running.correction is not None
    sent_to = state.delivery.sent_to
    report.frames_superseded += state.delivery.superseded(first_frame)
    answered = state.edits.landed(running.answers, first_frame, state.delivery.sent_to)
    seqs = tuple(edit.event_seq for edit, _ in answered)
    notice = PlanNotice(state.key, state.plan, first_frame, running.job.cause, seqs)
    state.delivery.plan_log.note(notice, sent_to)
    return [
        notice,
        *(edit.done(state.key, frame) for edit, frame in answered),
        *state.settle(),
    ]


def _note_deadline(state: SessionState, running: RunningWindow, now: float, report: StepReport) -> None:
    if state.spec.is_clip:
        return
    report.deadlines.append(state.spec.priority)
    # A paused client cannot run out of frames.
    counts = state.clock.running or running.job.cause is PlanCause.EDIT or state.planned_to == 0
    if counts and now > running.job.deadline:
        report.deadline_misses.append(state.spec.priority)
