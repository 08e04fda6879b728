"""StandingRunner: makes characters of any model stand and takes no time, to measure the engine's own time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from motiongen_server.engine.types import (
    ChannelBlock,
    Float32Array,
    ModelFacts,
    RowStatus,
    WindowJob,
    WindowResult,
)


class StandingRunner:
    """A `motiongen_server.engine.ports.Runner` whose windows are all the same."""

    def __init__(self, facts: ModelFacts) -> None:
        self.facts = facts
        self._steps_done: dict[int, int] = {}
        self._frames = np.concatenate([_resting(block, facts.horizon) for block in facts.rig.blocks], axis=1)
        self._features = np.zeros((facts.horizon, facts.feature_dim), np.float32)
        self._tokens = np.zeros((facts.horizon // facts.patch, facts.token_width), np.float32)

    def num_passes(self, job: WindowJob) -> int:
        """One for every job."""
        del job
        return 1

    def features(self, rows: Float32Array) -> Float32Array:
        """Zeros."""
        return np.zeros((len(rows), self.facts.feature_dim), np.float32)

    def outputs(self, names: Sequence[str], rows: Float32Array) -> Float32Array:
        """Not implemented: sessions on this runner ask for no outputs."""
        raise NotImplementedError(f"no outputs {names} of {len(rows)} rows")

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        """Take in new jobs."""
        self._steps_done.update((job.job_id, 0) for job in jobs)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        """Count the jobs' steps."""
        for job_id in job_ids:
            self._steps_done[job_id] += 1
        return [RowStatus(job_id, self._steps_done[job_id], finite=True) for job_id in job_ids]

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        """The same frames for all jobs."""
        for job_id in job_ids:
            del self._steps_done[job_id]
        return [WindowResult(job_id, self._frames, self._features, self._tokens) for job_id in job_ids]

    def discard(self, job_ids: Sequence[int]) -> None:
        """Forget jobs."""
        for job_id in job_ids:
            self._steps_done.pop(job_id, None)


def _resting(block: ChannelBlock, frames: int) -> Float32Array:
    """(frames, block width): identity rotations, and zeros for all else."""
    values = np.zeros((frames, block.width), np.float32)
    if block.name == "joint_rotation_quat_wxyz":
        values[:, ::4] = 1.0
    return values
