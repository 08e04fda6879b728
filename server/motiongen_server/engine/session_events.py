"""SessionEvents: applies events to open sessions, and updates the engine's records of them."""

from __future__ import annotations

from motiongen_server.engine.open_sessions import OpenSessions
from motiongen_server.engine.running_windows import RunningWindows
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.session import events
from motiongen_server.engine.session.opening import change_options
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import (
    Code,
    Outcome,
    Output,
    Playhead,
    Resume,
    SaveAgain,
    Seek,
    SetConstraints,
    SetOptions,
    SetPlayState,
    SetPrompts,
    SetVelocity,
)
from motiongen_server.engine.types.report import StepReport

EventWithin = (
    SetPrompts | SetConstraints | SetVelocity | Playhead | SetPlayState | SetOptions | Seek | Resume | SaveAgain
)
"""Every event except Open and Close."""


class SessionEvents:
    """Applies events to sessions, and keeps admission, counts and running windows consistent with the change."""

    def __init__(
        self, admission: Admission, sessions: OpenSessions, windows: RunningWindows, load_monitor: LoadMonitor
    ) -> None:
        self._admission = admission
        self._sessions = sessions
        self._windows = windows
        self._load_monitor = load_monitor

    def take(self, state: SessionState, event: EventWithin, now: float, report: StepReport) -> list[Output]:
        """Apply an event and touch its session. Returns the immediate outputs."""
        state.last_seq = max(state.last_seq, event.event_seq)
        job = state.running.job if state.running else None
        if isinstance(event, SetOptions):
            said = self._change(state, event)
        elif isinstance(event, Seek):
            said = self._cut(state, event, now, report)
        elif isinstance(event, SetPlayState):
            self._sessions.count(state, -1)
            said = events.apply(state, event, now, report)
            self._sessions.count(state, 1)
        else:
            said = events.apply(state, event, now, report)
        if job is not None and state.running is None:
            self._windows.discard(job.job_id)
        self._sessions.touch(state)
        return said

    def _cut(self, state: SessionState, event: Seek, now: float, report: StepReport) -> list[Output]:
        return events.cut(state, event, self._windows.features, now, report)

    def _change(self, state: SessionState, event: SetOptions) -> list[Output]:
        """Give a session other options, if there is room for what they ask.

        It stays on its level of service: options do not make a held session go on. In another class it gets what
        newcomers get there, but a session that was held stays held if sessions of that class are held.
        """
        before, changed = state.spec, event.changed(state.spec)
        refusal = self._admission.change(before, changed)
        if refusal is not None:
            return [refusal.outcome(event.session, event.event_seq)]
        self._sessions.leave_class(state)
        change_options(state, changed)
        self._sessions.join_class(state)
        said: list[Output] = [Outcome(event.session, event.event_seq, Code.OK)]
        if changed.priority is not before.priority:
            level = self._load_monitor.level(changed.priority)
            said += state.set_tier(level if state.level.hold and level.hold else level.of_newcomers)
        return said
