"""Warm-up: sizes of batches that a runner builds something for are played once before anybody waits for them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from motiongen_server.engine.ports import OutOfMemory, Runner
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array, WindowJob

# Windows of fewer frames of history are those of clients who change their minds at once: few are together.
_MOST_SHORT = 8


def warm_up(runner: Runner, sizes: Iterable[int], history_frames: int) -> int:
    """Play first windows, and windows that go on, so many of each together, in each of the rising sizes.

    Small sizes are played with each shorter history, too. Returns the largest size that there was memory for, 0 for
    none; what is wrong with a model, `profile` finds out.
    """
    job_ids = itertools.count(-1, -1)  # never those of an engine
    nothing: Float32Array = np.zeros((0, runner.facts.feature_dim), np.float32)
    largest, history = 0, nothing

    def jobs(size: int, before: Float32Array) -> list[WindowJob]:
        return [trial_job(runner.facts, next(job_ids), before, is_steered=False) for _ in range(size)]

    for size in sizes:
        try:
            begun = _played(runner, jobs(size, nothing))
            history = history if largest else begun[:history_frames]
            shorter = range(runner.facts.patch, history_frames, runner.facts.patch) if size <= _MOST_SHORT else ()
            for frames in (*shorter, history_frames):
                _played(runner, jobs(size, history[:frames]))
        except OutOfMemory:
            break
        largest = size
    return largest


def _played(runner: Runner, jobs: Sequence[WindowJob]) -> Float32Array:
    """The first one's features."""
    ids = [job.job_id for job in jobs]
    try:
        runner.prepare(jobs)
        for _ in range(jobs[0].num_steps):
            runner.denoise(ids)
        return runner.decode(ids)[0].features
    finally:
        runner.discard(ids)
