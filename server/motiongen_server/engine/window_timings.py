"""WindowTimings: records when the steps of windows began, and adds this to the notices of their plans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from motiongen_server.engine.session.windows import RunningWindow
from motiongen_server.engine.types import Output, PlanNotice, RowStatus
from motiongen_server.engine.types.tracing import WindowTiming


class WindowTimings:
    """Timings of one engine's windows, by job number. name: the engine's."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._begun: dict[int, float] = {}

    def __len__(self) -> int:
        """Windows that have begun and not ended."""
        return len(self._begun)

    def note_step(self, statuses: Iterable[RowStatus], begun_at: float) -> None:
        """Windows have taken a step that began at begun_at."""
        for status in statuses:
            self._begun.setdefault(status.job_id, begun_at)

    def forget(self, job_id: int) -> None:
        """The window of this job is discarded."""
        self._begun.pop(job_id, None)

    def with_timing(self, outputs: Sequence[Output], window: RunningWindow, now: float) -> list[Output]:
        """A landed window's outputs, with its timing on the PlanNotice; a window that came too late has none."""
        job = window.job
        begun_at = self._begun.pop(job.job_id, now)
        asked_at = min((edit.received_at for edit in window.answers), default=job.created_at)
        timing = WindowTiming(asked_at, job.created_at, begun_at, now, job.num_steps, self._name)
        return [replace(said, timing=timing) if isinstance(said, PlanNotice) else said for said in outputs]
