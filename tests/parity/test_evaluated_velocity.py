"""The evaluation gives a window the same targets and the same gait for a velocity as the server does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from motiongen_ardy.capabilities import LocomotionPreset
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate import sampler as evaluation
from motiongen_ardy.evaluate.sampler import Sampler, Sampling
from motiongen_ardy.evaluate.take import Steer, Take
from motiongen_ardy.locomotion.gait import gait_of
from motiongen_ardy.locomotion.velocity import root_state
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import RolloutRequest
from motiongen_ardy.model.sampling.options import GuidanceOptions, PlanOptions, SamplingOptions
from motiongen_server.engine.session.velocity import Velocity
from motiongen_server.engine.types import (
    Constraint,
    Direction,
    Gait,
    Guidance,
    PlanCause,
    Priority,
    SessionKey,
    Waypoint,
    WindowJob,
)
from motiongen_server.runner.targets import job_targets

FIRST = 20


@pytest.mark.parametrize("stride", [1, 5])
@pytest.mark.parametrize("seed", range(24))
def test_targets_are_those_of_the_server(model: Model, monkeypatch: pytest.MonkeyPatch, seed: int, stride: int) -> None:
    random = np.random.default_rng(seed)
    options = SamplingOptions(
        GuidanceOptions("joint", 1.0, 1.0), plan_root=True, plan=PlanOptions(stride_frames=stride)
    )
    monkeypatch.setattr(model, "sampling", options)
    x, z = (0.0, 0.0) if seed % 7 == 0 else (float(value) for value in random.normal(size=2) * 2)
    heading = None if seed % 2 else float(random.uniform(-4, 4))
    hold = int(random.integers(1, 60))
    features = torch.from_numpy(random.normal(size=(FIRST, model.representation.feature_dim)) / 5).float()
    frame = FIRST + 2 + int(random.integers(0, 12))

    given = Targets(model.skeleton)
    given.add_waypoints([frame], torch.tensor([[9.0, 8.0]]), torch.tensor([0.5]) if seed % 3 else None)
    history = model.representation.denormalize(features)
    take = Take("a", 0, 100, ((0, ""),), history=history, targets=given, steers=(Steer(FIRST, x, z, heading, hold),))
    mine = evaluated_targets(model, monkeypatch, take)

    last = model.representation.denormalize(model.representation.normalize(history).float())
    facing = float(torch.atan2(last[-1, 4], last[-1, 3]))
    state = root_state(last[:, [0, 2]].numpy(), facing, model.config.fps)
    path = Velocity(x, z, heading, hold, FIRST).path(FIRST, FIRST + model.config.horizon, state, model.config.fps)
    point = Waypoint(1, frame, 9.0, 8.0, 0.5 if seed % 3 else None)
    theirs = job_targets(model.skeleton, job_of([point] if path is None else [path, point]), stride)
    assert theirs is not None
    assert (mine.planned, mine.faced) == (theirs.planned, theirs.faced)
    for name in ("ground", "heading"):
        ours, served = getattr(mine, name), getattr(theirs, name)
        assert ours.keys() == served.keys()
        assert all(np.allclose(ours[at], served[at], rtol=1e-5, atol=1e-4) for at in served)


def evaluated_targets(model: Model, monkeypatch: pytest.MonkeyPatch, take: Take) -> Targets:
    """The targets that the evaluation sets for the first window of a take."""
    asked: list[RolloutRequest] = []

    def look(model: Model, request: RolloutRequest, features: torch.Tensor, index: int) -> Any:
        asked.append(request)
        raise StopIteration

    monkeypatch.setattr(evaluation, "next_window", look)
    words = SimpleNamespace(encode=lambda texts: np.zeros((len(texts), model.config.denoiser.text_dim), np.float32))
    with pytest.raises(StopIteration):
        Sampler(model, words, Sampling(2)).run([take])  # type: ignore[arg-type]
    assert asked[0].targets is not None
    return asked[0].targets


def job_of(constraints: Sequence[Constraint]) -> WindowJob:
    """A window job with these constraints; its other fields do not matter here."""
    return WindowJob(
        job_id=1,
        session=SessionKey(1, 1),
        plan=1,
        first_frame=FIRST,
        history=np.zeros((0, 1), np.float32),
        start_pose=None,
        embedding=None,
        constraints=tuple(constraints),
        seed=0,
        num_steps=2,
        guidance=Guidance(1.0, 1.0),
        deadline=0.0,
        priority=Priority.NEAR,
        cause=PlanCause.CONTINUE,
        created_at=0.0,
    )


def test_presets_have_the_quarters_of_server_gaits_and_are_chosen_by_direction() -> None:
    nothing = np.zeros(3, np.float32)
    for direction in Direction:
        preset = LocomotionPreset("walk", "walk", 0.0, direction.name.lower())
        assert preset.quarter == Gait("walk", "walk", 0.0, direction, nothing).quarter
    back = LocomotionPreset("back", "back", 0.15, "backward")
    walk = replace(back, name="walk", direction="forward")
    assert gait_of((walk, back), 0.0, -1.0, 0.0, None) is back
    assert gait_of((walk, back), 0.0, 1.0, 0.0, back) is walk
