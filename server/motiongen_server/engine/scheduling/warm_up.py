"""Warm-up: computes windows in the batch sizes for which a runner builds something, before anybody waits for them."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from motiongen_server.engine.ports import OutOfMemory, Runner
from motiongen_server.engine.scheduling.trial_jobs import trial_job
from motiongen_server.engine.types import Float32Array, WindowJob

# Windows with a shorter history are those of clients that edit right after opening: few come together.
_MOST_SHORT = 8


def warm_up(runner: Runner, sizes: Iterable[int], history_frames: int) -> int:
    """Compute this many first windows, and windows that continue, together, for each of the rising sizes.

    Small sizes are computed with each shorter history, too. Returns the largest size for which there was memory, 0 for
    none; problems with the model are left to `profile` to find.
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
    """Compute windows from start to end. Returns the first one's features."""
    ids = [job.job_id for job in jobs]
    try:
        runner.prepare(jobs)
        for _ in range(jobs[0].num_steps):
            runner.denoise(ids)
        return runner.decode(ids)[0].features
    finally:
        runner.discard(ids)
