"""Takes equal those that the rollout generates, whatever else is in their batch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate.sampler import Sampler, Sampling
from motiongen_ardy.evaluate.take import Steer, Take
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.model.sampling.options import GuidanceOptions, SamplingOptions

TINY = Path(__file__).parents[2] / "data" / "golden" / "tiny-core27" / "checkpoint"
TOLERANCE = 2e-4


class Words:
    """A text encoder whose vectors depend on nothing but the length of a text."""

    def __init__(self, width: int) -> None:
        self.width = width
        self.identity = "words"

    def encode(self, texts: list[str]) -> np.ndarray:
        rows = [
            np.random.default_rng(len(text)).standard_normal(self.width) if text else np.zeros(self.width)
            for text in texts
        ]
        return np.stack(rows).astype(np.float32)


@pytest.fixture(scope="module", params=["released", "corrected"])
def model(request: pytest.FixtureRequest) -> Model:
    model = load_checkpoint(TINY)
    if request.param == "corrected":
        joint = GuidanceOptions(mode="joint", text=1.0, constraint=1.0)
        model.sampling = SamplingOptions(joint, project_root=True, plan_root=True, clean_feet=True, reach_joints=True)
    return model


@pytest.fixture
def sampler(model: Model) -> Sampler:
    return Sampler(model, Words(model.config.denoiser.text_dim), Sampling(3, GuidanceWeights(1.5, 2.5)))


def goal(model: Model, frame: int) -> Targets:
    targets = Targets(model.skeleton)
    targets.add_waypoints([frame], torch.tensor([[0.3, 1.1]]))
    return targets


def test_a_take_equals_the_rollout_of_the_same_request(model: Model, sampler: Sampler) -> None:
    horizon = model.config.horizon
    change, end = horizon + horizon // 2, 3 * horizon
    take = Take("a", 5, end, ((0, "walk"), (change, "stand")), targets=goal(model, horizon + 3), start=(1.0, 2.0, 0.5))
    request = RolloutRequest(
        num_frames=end,
        text=sampler.text("walk")[0],
        later_text=((change, sampler.text("stand")[0]),),
        seed=5,
        num_steps=3,
        weights=GuidanceWeights(1.5, 2.5),
        targets=goal(model, horizon + 3),
        start=(1.0, 2.0, 0.5),
    )
    done = sampler.run([take])[0]
    expected = model.representation.denormalize(rollout(model, request))
    assert done.features.shape == expected.shape
    assert torch.allclose(done.features, expected, atol=TOLERANCE, rtol=TOLERANCE)
    options = model.sampling
    second = horizon + 3 - options.approach_frames if options.plan_root else horizon  # the goal gets room
    assert done.window_starts == (0, second, change, change + horizon)


def test_takes_do_not_depend_on_others_in_their_batch(model: Model, sampler: Sampler) -> None:
    horizon = model.config.horizon
    takes = [
        Take("a", 1, 2 * horizon, ((0, "walk"),)),
        Take("b", 2, horizon + 5, ((0, ""),), targets=goal(model, horizon + 4)),
        Take("c", 3, 2 * horizon, ((0, "run"), (9, "wave"))),
        Take("d", 4, 2 * horizon, ((0, "walk"),), steers=(Steer(horizon, 0.0, 1.0),)),
    ]
    together = sampler.run(takes)
    for take, result in zip(takes, together, strict=True):
        alone = sampler.run([take])[0]
        assert len(result.features) == take.num_frames
        assert torch.allclose(result.features, alone.features, atol=TOLERANCE, rtol=TOLERANCE)


def test_a_take_continues_from_its_history(model: Model, sampler: Sampler) -> None:
    first = sampler.run([Take("a", 1, 16, ((0, "walk"),))])[0]
    second = sampler.run([Take("a", 2, 16 + model.config.horizon, ((0, "walk"),), history=first.features)])[0]
    assert torch.allclose(second.features[:16], first.features, atol=1e-4)
    assert second.window_starts == (16,)


def test_a_velocity_is_in_force_for_its_hold_frames_unless_another_replaces_it() -> None:
    first, second = Steer(20, 0.0, 1.0, hold_frames=30), Steer(60, 1.0, 0.0, hold_frames=10)
    apart = Take("a", 0, 100, ((0, ""),), steers=(first, second))
    expected = {19: None, 20: first, 49: first, 50: None, 59: None, 60: second, 69: second, 70: None}
    assert {frame: apart.steer_at(frame) for frame in expected} == expected
    assert [apart.steer_at(frame, after=5) for frame in (54, 55, 74, 75)] == [first, None, second, None]
    assert [apart.next_change(frame) for frame in (0, 20, 50, 60, 70)] == [20, 50, 60, 70, 100]

    longer = Steer(20, 0.0, 1.0, hold_frames=70)
    replaced = Take("a", 0, 100, ((0, ""),), steers=(longer, second))
    assert [replaced.steer_at(frame) for frame in (59, 60, 70, 89)] == [longer, second, None, None]
    assert [replaced.next_change(frame) for frame in (20, 60, 70)] == [60, 70, 100]
