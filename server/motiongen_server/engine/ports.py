"""What the engine needs from outside. The engine knows these shapes only, never who fills them."""

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
        """Evaluations of the denoiser that one step of this job costs, 1 to 4."""
        ...

    def features(self, rows: Float32Array) -> Float32Array:
        """Normalized features (H, D) of frames (H, row_width) as they are on the wire, one patch or more."""
        ...

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        """(T - 1, W) float32: the blocks of `facts.outputs` by name, side by side, of all rows (T, row_width) but the
        first, which is the frame before them; for those that have none, it is as the second."""
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
