"""The interfaces that the engine needs from outside; it does not know their implementations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

from motiongen_server.engine.types import (
    Event,
    Float32Array,
    ModelFacts,
    Output,
    RowStatus,
    WindowJob,
    WindowResult,
)
from motiongen_server.engine.types.report import StepReport


class OutOfMemory(RuntimeError):
    """A runner's call did not fit into the device's memory. No job has changed: the call may be repeated in parts."""


class DeviceLost(RuntimeError):
    """The device is gone, and every job with it. The engine ends; only a new process can serve again."""


class Runner(Protocol):
    """Owns the device and the model. Called from the engine's thread only.

    A job lives in the runner from `prepare` until `decode` or `discard`. Rows of one call may differ in everything:
    steps done, step count, history length, guidance, constraints, prompt, seed. What a row gets never depends on the
    others. A call that raises leaves every job as it was before the call, so that the call can be repeated with fewer
    jobs; an exception therefore concerns the jobs of the call as a whole.
    """

    @property
    def facts(self) -> ModelFacts:
        """The loaded model's rates and limits; they never change."""
        ...

    def num_passes(self, job: WindowJob) -> int:
        """Evaluations of the denoiser that one step of this job costs, 1 to 4."""
        ...

    def features(self, rows: Float32Array) -> Float32Array:
        """Normalized features (H, D) of frames (H, row_width) in wire format; H is at least one patch."""
        ...

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        """The named blocks of `facts.outputs`, side by side, for rows (T, row_width) but the first: (T - 1, W) float32.

        The first row is the frame before the others; for frames that have none before them, it equals the second row.
        """
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
        """Forget jobs at any stage. Unknown ids are ignored. Never raises."""
        ...


class Clock(Protocol):
    """Monotonic time, never wall-clock time."""

    def now(self) -> float:
        """Seconds since some fixed moment."""
        ...


class Inbox(Protocol):
    """Where the loop takes its events from; within one process it is `motiongen_server.engine.mailbox.Mailbox`."""

    def put(self, event: Event) -> bool:
        """Hand in an event, from any thread. False: not taken, since its session has too many waiting."""
        ...

    def take_all(self) -> list[Event]:
        """All waiting events, oldest first. Called on the engine's thread."""
        ...

    def wait(self, timeout_s: float) -> None:
        """Sleep until an event arrives, `ring` is called, or timeout_s has passed. Called on the engine's thread."""
        ...

    def ring(self) -> None:
        """End the current or the next `wait` although no event came; from any thread."""
        ...


Deliver: TypeAlias = Callable[[Sequence[Output]], None]
"""Receives the outputs of one step, in order, on the engine's thread. Must return at once and never raise."""

Observe: TypeAlias = Callable[[StepReport], None]
"""Receives the report of every step, on the engine's thread. Must return at once and never raise."""
