"""WindowTimings: when the steps of windows began, put on the notices of the plans that they become."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from motiongen_server.engine.session.windows import RunningWindow
from motiongen_server.engine.types import Output, PlanNotice, RowStatus
from motiongen_server.engine.types.tracing import WindowTiming


class WindowTimings:
    """Of the windows of one engine, by the numbers of their jobs. name: of the engine."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._begun: dict[int, float] = {}

    def __len__(self) -> int:
        """Windows that have begun and not ended."""
        return len(self._begun)

    def note_step(self, statuses: Iterable[RowStatus], begun_at: float) -> None:
        """These windows have taken a step that began then."""
        for status in statuses:
            self._begun.setdefault(status.job_id, begun_at)

    def forget(self, job_id: int) -> None:
        """Its window is discarded."""
        self._begun.pop(job_id, None)

    def with_timing(self, outputs: Sequence[Output], window: RunningWindow, now: float) -> list[Output]:
        """What is said of a window that has landed, its notice with its times; nothing of it where it came too late."""
        job = window.job
        begun_at = self._begun.pop(job.job_id, now)
        asked_at = min((edit.received_at for edit in window.answers), default=job.created_at)
        timing = WindowTiming(asked_at, job.created_at, begun_at, now, job.num_steps, self._name)
        return [replace(said, timing=timing) if isinstance(said, PlanNotice) else said for said in outputs]
