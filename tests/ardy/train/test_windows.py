"""Training windows and the constraints drawn for them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from motiongen_ardy.constraint import Targets
from motiongen_ardy.representation import Representation
from motiongen_ardy.train.constraint_sampling import ConstraintChances, ConstraintSampler
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, measure_stats, natural_layout
from motiongen_ardy.train.windows import TrainingWindows, WindowSampler
from tests.ardy.train.clips import swinging_dataset

KINDS = ("waypoints", "trajectory", "keyframes", "keyframe_block", "end_effectors", "planted_feet")


@pytest.fixture(scope="module")
def bank() -> FeatureBank:
    dataset = swinging_dataset()
    return build_feature_bank(dataset, natural_layout(dataset.skeleton, 20))


@pytest.fixture(scope="module")
def layout(bank: FeatureBank) -> Representation:
    dataset = swinging_dataset()
    return Representation(dataset.skeleton, 20, measure_stats(bank, natural_layout(dataset.skeleton, 20), 64))


@pytest.fixture(scope="module")
def batches(bank: FeatureBank, layout: Representation) -> list[TrainingWindows]:
    embeddings = np.ones((len(bank.texts), 8), np.float32)
    sampler = WindowSampler(bank, embeddings, layout, horizon=40, batch=16)
    generator = torch.Generator().manual_seed(0)
    return [sampler.sample(generator) for _ in range(12)]


def test_short_clips_are_left_out_and_mirrors_are_added_where_allowed(bank: FeatureBank) -> None:
    assert sorted(bank.length) == [16, 16, 30, 44, 44, 90, 160, 160]
    assert bank.weight.sum() == pytest.approx(1)
    mirrored = [clip for clip in bank.clips if "right" in clip.captions[0]]
    assert len(mirrored) == 3


def test_lengths_are_whole_tokens_within_the_window(batches: list[TrainingWindows]) -> None:
    for windows in batches:
        for lengths in (windows.history_len, windows.generation_len, windows.length):
            assert bool((lengths % 4 == 0).all())
        assert bool((windows.generation_len >= 16).all())
        assert bool((windows.generation_len <= 40).all())
        assert bool((windows.history_len + windows.generation_len <= windows.length).all())
        assert windows.features.shape[1] == int(windows.length.max())


def test_the_origin_is_the_last_history_frame(batches: list[TrainingWindows], layout: Representation) -> None:
    for windows in batches:
        natural = layout.denormalize(windows.features)
        origin = (windows.history_len - 1).clamp(min=0)
        ground = natural[torch.arange(len(origin)), origin][:, [0, 2]]
        assert ground.abs().max() < 1e-4


def test_constraints_stand_after_the_history_and_before_the_end(batches: list[TrainingWindows]) -> None:
    seen = 0
    for windows in batches:
        frames = torch.arange(windows.mask.shape[1])[None]
        outside = (frames < windows.history_len[:, None]) | (frames >= windows.length[:, None])
        assert not windows.mask[outside].any()
        assert torch.equal(windows.observed, windows.features * windows.mask)
        seen += int(windows.mask.any())
    assert seen > 0


def test_some_texts_and_some_constraints_are_dropped(batches: list[TrainingWindows]) -> None:
    told = torch.cat([windows.text.abs().sum((1, 2)) > 0 for windows in batches]).float().mean()
    constrained = torch.cat([windows.mask.flatten(1).any(1) for windows in batches]).float().mean()
    assert 0.75 < told < 0.99
    assert 0.3 < constrained < 0.9


def only(kind: str) -> ConstraintChances:
    return ConstraintChances(none=0.0, second_kind=0.0, **{name: float(name == kind) for name in KINDS})


def columns_at_run_time(kind: str, layout: Representation) -> list[torch.Tensor]:
    """The masks (D) that `motiongen_ardy.constraint` fills for one frame of a kind of constraint."""
    skeleton = layout.skeleton
    positions = torch.randn(1, skeleton.num_joints, 3)
    rotations = torch.eye(3).expand(1, skeleton.num_joints, 3, 3)

    def mask(fill: object) -> torch.Tensor:
        targets = Targets(skeleton)
        fill(targets)  # type: ignore[operator]
        return targets.fill(layout, 0, 1)[1][0]

    if kind in ("waypoints", "trajectory"):
        return [
            mask(lambda targets: targets.add_root([0], torch.ones(1, 2))),
            mask(lambda targets: targets.add_root([0], torch.ones(1, 2), torch.zeros(1))),
        ]
    if kind in ("keyframes", "keyframe_block"):
        return [mask(lambda targets: targets.add_full_body([0], positions))]
    limbs = ("LeftFoot", "RightFoot") if kind == "planted_feet" else ("LeftHand", "RightHand", "LeftFoot", "RightFoot")
    chosen = [[limb for index, limb in enumerate(limbs) if bits >> index & 1] for bits in range(1, 1 << len(limbs))]
    return [
        mask(lambda targets, some=some: targets.add_end_effectors([0], [*some, "Hips"], positions, rotations))
        for some in chosen
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_training_covers_the_columns_that_run_time_fills(kind: str, layout: Representation) -> None:
    allowed = columns_at_run_time(kind, layout)
    sampler = ConstraintSampler(layout, only(kind))
    random = np.random.default_rng(0)
    found = 0
    for _ in range(40):
        mask = sampler.sample(random, 8, 48, 80, np.ones((80, 2), bool))
        assert not mask[:8].any()
        for row in mask[mask.any(axis=1)]:
            found += 1
            assert any(np.array_equal(row, columns.numpy() > 0) for columns in allowed), kind
    assert found > 0
