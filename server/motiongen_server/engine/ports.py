"""What the engine needs from outside. The engine knows these shapes only, never who fills them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeAlias

from motiongen_server.engine.scheduling.costs import CostTable
from motiongen_server.engine.scheduling.report import StepReport
from motiongen_server.engine.scheduling.scheduler import ScheduledJob
from motiongen_server.engine.types import (
    Event,
    Float32Array,
    ModelFacts,
    Output,
    Priority,
    RowStatus,
    WindowJob,
    WindowResult,
)


class OutOfMemory(RuntimeError):
    """A runner's call did not fit the device's memory. Every job is where it was: the call may be made in parts."""


class DeviceLost(RuntimeError):
    """The device is gone, and every job with it. The engine ends: only a new process can serve again."""


class Runner(Protocol):
    """Owns the device and the model. Called from the engine's thread alone.

    A job lives in the runner from `prepare` until `decode` or `discard`. Rows of one call may differ in everything:
    steps done, step count, history length, guidance, constraints, prompt, seed. What a row gets never depends on the
    others. A call that raises leaves every job where it was before the call, so that it may be made again for fewer
    jobs; an exception therefore concerns the jobs of the call as a whole.
    """

    @property
    def facts(self) -> ModelFacts:
        """The loaded model's rates and limits; they never change."""
        ...

    def num_passes(self, job: WindowJob) -> int:
        """Evaluations of the denoiser that one step of this job costs, 1 to 3."""
        ...

    def features(self, rows: Float32Array) -> Float32Array:
        """Normalized features (H, D) of frames (H, row_width) as they are on the wire, one patch or more."""
        ...

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        """Take in new jobs: history tokens, conditions, initial noise."""
        ...

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        """Advance each job by one denoising step; statuses are in the order of job_ids."""
        ...

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        """Turn jobs that have done all their steps into frames and forget them; results are in the order of job_ids."""
        ...

    def discard(self, job_ids: Sequence[int]) -> None:
        """Forget jobs at any stage. An id that is not held is no error. Never raises."""
        ...


class SchedulingPolicy(Protocol):
    """Decides which jobs are in the next denoising step. Holds every job from `add` to `remove`; never waits.

    Called from the engine's thread alone. `Scheduler` is the one that is served with; others can be measured in its
    place.
    """

    @property
    def costs(self) -> CostTable:
        """What calls of the runner cost; the engine keeps it up to date."""
        ...

    def __len__(self) -> int:
        """Jobs held."""
        ...

    def add(self, job: WindowJob, passes: int) -> None:
        """Take in a job. passes: what `Runner.num_passes` says of it."""
        ...

    def remove(self, job_id: int) -> None:
        """Let go of a job that is held, at any stage."""
        ...

    def schedule(self, now: float) -> Sequence[ScheduledJob]:
        """The jobs of the next step, most urgent first. Empty: none before `wake_at`, unless more comes."""
        ...

    def wake_at(self) -> float:
        """When to ask again though nothing has come; infinity: no need to."""
        ...

    def mark_prepared(self, job_ids: Iterable[int]) -> None:
        """Note that the runner holds these jobs."""
        ...

    def commit(self, statuses: Iterable[RowStatus]) -> list[int]:
        """Note the steps that were done; returns the jobs that have done all of theirs."""
        ...

    def predict_s(self, priority: Priority, deadline: float, num_steps: int, passes: int) -> float:
        """Seconds until a job that is added now would be finished, as things stand."""
        ...


class Clock(Protocol):
    """Monotonic time; never wall-clock time."""

    def now(self) -> float:
        """Seconds since some fixed moment."""
        ...


class Inbox(Protocol):
    """Where the loop takes its events from; `motiongen_server.engine.mailbox.Mailbox` is the one within a process."""

    def put(self, event: Event) -> bool:
        """Hand in an event, from any thread. False: it was not taken, its session has too many waiting."""
        ...

    def take_all(self) -> list[Event]:
        """All events that wait, oldest first. Called on the engine's thread."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Sleep until something has come, or timeout_s has passed. Called on the engine's thread."""
        ...

    def ring(self) -> None:
        """End the current or the next `wait` without an event, from any thread."""
        ...


Deliver: TypeAlias = Callable[[Sequence[Output]], None]
"""Takes the outputs of one step, in order, on the engine's thread. Must return at once and never raise."""

Observe: TypeAlias = Callable[[StepReport], None]
"""Takes the report of every step, on the engine's thread. Must return at once and never raise."""
