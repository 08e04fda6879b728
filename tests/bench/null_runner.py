"""A runner that computes nothing, so that the remaining time is the cost of the engine and of the service.

It returns frames of the built-in rig's size, so that as many bytes are sent as with a model.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from motiongen_server.engine.standing_runner import StandingRunner
from motiongen_server.engine.types import ChannelBlock, RigLayout, RowStatus
from tests.server.engine import fakes

NUM_JOINTS = 27
FEATURE_DIM = 12 * NUM_JOINTS + 6
TOKEN_WIDTH = 52
STEP_S = 0.002
"""The duration of a step, if it is to have one: as with a model, events that arrive during it are handled together."""

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


class NullRunner(StandingRunner):
    """A runner for the built-in rig. step_s: how long a step waits."""

    facts = FACTS

    def __init__(self, step_s: float = 0.0) -> None:
        super().__init__(FACTS)
        self._step_s = step_s

    def denoise(self, job_ids: Sequence[int]) -> list[RowStatus]:
        if self._step_s:
            time.sleep(self._step_s)
        return super().denoise(job_ids)


class NullEncoder:
    """A text encoder whose vectors depend on the prompt's length; if all were equal, edits would change nothing."""

    identity = "null-1"

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        return np.repeat(np.array([[len(text)] for text in texts], np.float32), FACTS.embedding_dim, axis=1)
