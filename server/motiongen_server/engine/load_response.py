"""LoadResponse: acts on the engine's load: sessions get less, or more again; in the worst case some are closed."""

from __future__ import annotations

import logging
import math

from motiongen_server.engine.open_sessions import OpenSessions
from motiongen_server.engine.running_windows import RunningWindows
from motiongen_server.engine.scheduling.degradation import EXPENDABLE
from motiongen_server.engine.scheduling.load_monitor import LoadMonitor
from motiongen_server.engine.session.state import SessionState
from motiongen_server.engine.types import Output, Priority
from motiongen_server.engine.types.report import StepReport

_log = logging.getLogger(__name__)

# The share of the sessions of a class that is shed each time the last level did not help.
_SHED_SHARE = 0.05


class LoadResponse:
    """Carries out the load monitor's decisions."""

    def __init__(self, monitor: LoadMonitor, windows: RunningWindows, sessions: OpenSessions) -> None:
        self._monitor = monitor
        self._windows = windows
        self._sessions = sessions

    def measure(self, now: float) -> list[Output]:
        """Measure the load, and move sessions of the classes whose level changes. Returns the outputs for them."""
        windows, monitor = self._windows, self._monitor
        for job, share in windows.take_replans():
            monitor.note_replan(job.priority, job.owner, share)
        said: list[Output] = []
        moved = monitor.measure(now, windows.use, windows.prices(), self._sessions.present)
        for priority in moved:
            level = monitor.level(priority)
            _log.warning(
                "the load is %.0f %%: class %s is served %s now, with at most %s steps",
                100 * monitor.load,
                priority.name,
                level.tier.name,
                level.steps or "all",
            )
            of_class = self._of_class(priority)
            for state, given in zip(of_class, level.of_class(len(of_class)), strict=True):
                said += state.set_tier(given)
                self._sessions.touch(state)
        return said

    def to_shed(self) -> list[SessionState]:
        """If the last level did not help: the newest sessions of the least urgent class, newest first; else none."""
        if not self._monitor.shed:
            return []
        lowest = max(priority for priority in EXPENDABLE if self._sessions.present[priority])
        of_class = self._of_class(lowest)
        return of_class[::-1][: math.ceil(_SHED_SHARE * len(of_class))]

    def _of_class(self, priority: Priority) -> list[SessionState]:
        """The sessions of a class, oldest first."""
        return [state for state in self._sessions if state.spec.priority is priority and not state.spec.is_clip]

    def describe(self, report: StepReport) -> None:
        """Put the load and the tier of each class into the report."""
        report.load = self._monitor.spoken_for
        report.tiers = {priority: self._monitor.level(priority).tier for priority in Priority}
