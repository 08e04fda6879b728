"""A runner that computes nothing: what is left of the time is the cost of the engine and of the service.

It gives frames of the built-in rig's size, so that the bytes on the wire are the real ones.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.types import ChannelBlock, RigLayout, RowStatus, WindowJob, WindowResult
from tests.server.engine import fakes

NUM_JOINTS = 27
FEATURE_DIM = 12 * NUM_JOINTS + 6
TOKEN_WIDTH = 52
STEP_S = 0.002
"""What a step takes on the clock where it is to: as with a model, what comes during one is taken up together."""

FACTS = replace(
    fakes.FACTS,
    model_id="null",
    rig=RigLayout(
        rig_id="core27",
        joint_names=tuple(f"joint{number}" for number in range(NUM_JOINTS)),
        parents=tuple(range(-1, NUM_JOINTS - 1)),
        neutral_offsets=np.zeros((NUM_JOINTS, 3), np.float32),
        blocks=(
            ChannelBlock("root_translation_m", 3),
            ChannelBlock("joint_rotation_quat_wxyz", 4 * NUM_JOINTS),
            ChannelBlock("foot_contact", 4),
        ),
    ),
    feature_dim=FEATURE_DIM,
    embedding_dim=8,
    token_width=TOKEN_WIDTH,
    guidance_passes=1,
    num_parameters=0,
)


class NullRunner:
    """Satisfies `motiongen_server.engine.ports.Runner`; every window rests. step_s: what a step waits."""

    facts = FACTS

    def __init__(self, step_s: float = 0.0) -> None:
        self._step_s = step_s
        self._steps_done: dict[int, int] = {}
        self._frames = np.zeros((FACTS.horizon, FACTS.row_width), np.float32)
        self._frames[:, 3 : 3 + 4 * NUM_JOINTS : 4] = 1.0
        self._features = np.zeros((FACTS.horizon, FACTS.feature_dim), np.float32)
        self._tokens = np.zeros((FACTS.horizon // FACTS.patch, FACTS.token_width), np.float32)

    def num_passes(self, job: WindowJob) -> int:
        del job
        return 1

    def features(self, rows: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.zeros((len(rows), FEATURE_DIM), np.float32)

    def outputs(self, names: Sequence[str], rows: NDArray[np.float32]) -> NDArray[np.float32]:
        """None are offered."""
        raise NotImplementedError(f"no outputs {names} of {len(rows)} rows")

    def prepare(self, jobs: Sequence[WindowJob]) -> None:
        self._steps_done.update((job.job_id, 0) for job in jobs)

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        if self._step_s:
            time.sleep(self._step_s)
        for job_id in job_ids:
            self._steps_done[job_id] += 1
        return [RowStatus(job_id, self._steps_done[job_id], finite=True) for job_id in job_ids]

    def decode(self, job_ids: Sequence[int]) -> list[WindowResult]:
        for job_id in job_ids:
            del self._steps_done[job_id]
        return [WindowResult(job_id, self._frames, self._features, self._tokens) for job_id in job_ids]

    def discard(self, job_ids: Sequence[int]) -> None:
        for job_id in job_ids:
            self._steps_done.pop(job_id, None)


class NullEncoder:
    """A text encoder that knows a prompt by its length; were all equal, edits would change nothing."""

    identity = "null-1"

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        return np.repeat(np.array([[len(text)] for text in texts], np.float32), FACTS.embedding_dim, axis=1)
