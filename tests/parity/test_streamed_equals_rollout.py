"""A session streams the same motion as the plain rollout, window for window."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import RolloutRequest, rollout, usual_history
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.types import (
    Chunk,
    Constraint,
    Guidance,
    Open,
    Output,
    Playhead,
    Priority,
    Prompt,
    SessionKey,
    SessionSpec,
    StartPose,
    Waypoint,
)
from motiongen_server.runner import TorchRunner
from tests.parity.conftest import TOLERANCE
from tests.server.engine.fakes import FakeClock

KEY = SessionKey(1, 1)
NUM_FRAMES = 120
STEPS = 4


@dataclass
class Screen:
    """Keeps the frame rows that arrive."""

    rows: dict[int, np.ndarray] = field(default_factory=dict)

    def deliver(self, outputs: list[Output]) -> None:
        for output in outputs:
            if isinstance(output, Chunk):
                self.rows.update(enumerate(output.rows, output.first_frame))


def stream(
    model: Model,
    embedding: np.ndarray,
    constraints: tuple[Constraint, ...],
    reuse_tokens: bool,
    keep_prompts: bool = False,
) -> np.ndarray:
    """The first NUM_FRAMES rows that a session with one prompt streams."""
    clock, screen = FakeClock(), Screen()
    engine = Engine(
        TorchRunner(model, "tiny"),
        clock,
        screen.deliver,
        EngineConfig(
            history_crop=usual_history(model.config.patch),
            continue_jitter=0,
            stride_jitter=0,
            reuse_tokens=reuse_tokens,
            playback_rate=1e6,
        ),
    )
    spec = SessionSpec(
        KEY,
        seed=7,
        model_id="tiny",
        priority=Priority.NEAR,
        lookahead=80,
        denoise_steps=STEPS,
        guidance=Guidance(2.0, 1.5),
        start_pose=StartPose(1.0, -2.0, 0.5),
        prompts=(Prompt(1, None, None, "walk", embedding),),
        constraints=constraints,
        keep_prompts=keep_prompts,
    )
    engine.submit(Open(spec, 1, clock.now()))
    for _ in range(400):
        engine.step()
        clock.advance(0.01)
        if screen.rows:
            shown = max(screen.rows)
            engine.submit(Playhead(KEY, 0, clock.now(), max(0, shown - 30), shown + 1, 0))
        if len(screen.rows) >= NUM_FRAMES:
            break
    return np.stack([screen.rows[frame] for frame in range(NUM_FRAMES)])


def expected(
    model: Model, embedding: np.ndarray, targets: Targets | None, reuse_tokens: bool, keep_prompts: bool = False
) -> torch.Tensor:
    request = RolloutRequest(
        num_frames=NUM_FRAMES,
        text=torch.from_numpy(embedding),
        seed=7,
        num_steps=STEPS,
        weights=GuidanceWeights(2.0, 1.5),
        reuse_tokens=reuse_tokens,
        targets=targets,
        start=(1.0, -2.0, 0.5),
        keep_prompts=keep_prompts,
    )
    return model.representation.denormalize(rollout(model, request))


def compare(model: Model, rows: np.ndarray, features: torch.Tensor) -> None:
    motion = model.representation.motion(features)
    positions = torch.from_numpy(rows[:, :3])
    assert (positions - motion.root_positions).abs().max() < TOLERANCE
    assert torch.equal(torch.from_numpy(rows[:, -4:]) > 0.5, motion.foot_contacts)


@pytest.mark.parametrize("reuse_tokens", [False, True])
def test_session_with_a_prompt_streams_the_frames_of_the_rollout(model: Model, reuse_tokens: bool) -> None:
    embedding = np.random.default_rng(1).standard_normal(32).astype(np.float32)
    compare(model, stream(model, embedding, (), reuse_tokens), expected(model, embedding, None, reuse_tokens))


@pytest.mark.parametrize("reuse_tokens", [False, True])
def test_session_with_waypoints_in_and_beyond_its_window_matches_the_rollout(model: Model, reuse_tokens: bool) -> None:
    embedding = np.random.default_rng(2).standard_normal(32).astype(np.float32)
    targets = Targets(model.skeleton)
    targets.add_waypoints([30, 70], torch.tensor([[1.5, -1.0], [2.0, 0.5]]), torch.tensor([0.2, 0.4]))
    constraints = (Waypoint(1, 30, 1.5, -1.0, 0.2), Waypoint(2, 70, 2.0, 0.5, 0.4))
    features = expected(model, embedding, targets, reuse_tokens)
    compare(model, stream(model, embedding, constraints, reuse_tokens), features)
