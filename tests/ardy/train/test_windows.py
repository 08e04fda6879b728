"""Training windows and the constraints drawn for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import Representation
from motiongen_ardy.data.dataset import Segment
from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.train.caption_spans import caption_spans
from motiongen_ardy.train.constraint_sampling import FORMS, ConstraintChances, ConstraintSampler, WindowSpans
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, measure_stats, natural_layout
from motiongen_ardy.train.windows import OwnHistory, TrainingWindows, WindowSampler
from tests.ardy.train.clips import swinging_clip, swinging_dataset


@pytest.fixture(scope="module")
def bank() -> FeatureBank:
    dataset = swinging_dataset()
    return build_feature_bank(dataset, natural_layout(dataset.skeleton, 20))


@pytest.fixture(scope="module")
def layout(bank: FeatureBank) -> Representation:
    dataset = swinging_dataset()
    return Representation(dataset.skeleton, 20, measure_stats(bank, natural_layout(dataset.skeleton, 20), 64))


@pytest.fixture(scope="module")
def sampler(bank: FeatureBank, layout: Representation) -> WindowSampler:
    embeddings = np.ones((len(bank.captions.texts), 8), np.float32)
    return WindowSampler(bank, embeddings, layout, horizon=40, batch=24)


@pytest.fixture(scope="module")
def batches(sampler: WindowSampler) -> list[TrainingWindows]:
    generator = torch.Generator().manual_seed(0)
    return [sampler.sample(shape, generator) for shape in (*sampler.shapes, *sampler.shapes, OwnHistory())]


def test_short_clips_are_left_out_and_allowed_mirror_images_are_added(bank: FeatureBank) -> None:
    assert sorted(bank.length.tolist()) == [16, 16, 30, 44, 44, 90, 160, 160]
    assert float(bank.weight.sum()) == pytest.approx(1)
    mirrored = [clip for clip in bank.clips if "right" in clip.captions[0]]
    assert len(mirrored) == 3


def test_features_of_a_clip_do_not_depend_on_other_clips(bank: FeatureBank) -> None:
    dataset = swinging_dataset()
    alone = build_feature_bank(replace(dataset, clips=dataset.clips[4:5]), natural_layout(dataset.skeleton, 20), False)
    number = [clip.id for clip in bank.clips].index(dataset.clips[4].id)
    first = int(bank.first[number])
    torch.testing.assert_close(bank.features[first : first + 90], alone.features)


def test_lengths_are_whole_tokens_within_the_window(batches: list[TrainingWindows]) -> None:
    for windows in batches:
        for lengths in (windows.history_len, windows.generation_len, windows.length):
            assert bool((lengths % 4 == 0).all())
        assert bool((windows.generation_len >= 12).all())
        assert bool((windows.generation_len <= 40).all())
        assert bool((windows.history_len + windows.generation_len <= windows.num_known).all())
        assert windows.features.shape[1] >= int(windows.length.max())


def test_the_origin_is_the_last_history_frame(batches: list[TrainingWindows], layout: Representation) -> None:
    for windows in batches:
        natural = layout.denormalize(windows.features)
        origin = (windows.history_len - 1).clamp(min=0)
        ground = natural[torch.arange(len(origin)), origin][:, [0, 2]]
        assert ground.abs().max() < 1e-4


def test_constraints_are_placed_after_the_history_and_before_the_end(batches: list[TrainingWindows]) -> None:
    seen = 0
    for windows in batches:
        frames = torch.arange(windows.mask.shape[1])[None]
        outside = (frames < windows.history_len[:, None]) | (frames >= windows.length[:, None])
        assert not windows.mask[outside].any()
        exact = windows.exact
        assert torch.equal(windows.observed[exact], (windows.features * windows.mask)[exact])
        seen += int(windows.mask.any())
    assert seen > 0


def test_some_texts_and_some_constraints_are_dropped(batches: list[TrainingWindows]) -> None:
    told = torch.cat([windows.text.abs().sum((1, 2)) > 0 for windows in batches]).float().mean()
    constrained = torch.cat([windows.mask.flatten(1).any(1) for windows in batches]).float().mean()
    assert 0.7 < told < 0.97
    assert 0.5 < constrained < 0.97


def test_a_window_with_generated_history_continues_the_earlier_window(batches: list[TrainingWindows]) -> None:
    windows = batches[-1]
    earlier = windows.earlier
    assert earlier is not None
    assert bool(earlier.used.any())
    for row in torch.nonzero(earlier.used)[:, 0]:
        first = 4 * int(earlier.first_token[row])
        body_then = earlier.windows.features[row, first : first + 16, 5:]
        torch.testing.assert_close(windows.features[row, :16, 5:], body_then)
    made = torch.randn(len(windows.text), 14, 3)
    true = torch.zeros(len(windows.text), windows.features.shape[1] // 4, 3)
    history = earlier.as_history(made, true)
    row = int(torch.nonzero(earlier.used)[0])
    start = int(earlier.first_token[row])
    torch.testing.assert_close(history[row, :4], made[row, start : start + 4])
    assert not history[~earlier.used].any()


def test_windows_end_at_a_change_of_caption_or_take_the_new_one() -> None:
    clip = swinging_clip(1, 160)
    spans = (Segment(0, 80, "walk", ("walk",)), Segment(80, 80, "stand", ("stand",)))
    captions = caption_spans([replace(clip, segments=spans)])
    frames = torch.tensor([0, 50, 75, 100])
    chosen, generation = captions.draw(frames, torch.full((4,), 40), 160 - frames, 4, torch.Generator().manual_seed(0))
    assert [captions.texts[number] for number in chosen.tolist()] == ["walk", "walk", "stand", "stand"]
    assert generation.tolist() == [40, 28, 40, 40]


def only(form: str) -> ConstraintChances:
    return ConstraintChances(none=0.0, second_form=0.0, **{name: float(name == form) for name in FORMS})


def columns_at_run_time(form: str, layout: Representation) -> list[torch.Tensor] | None:
    """The masks (D) that `motiongen_ardy.core.constraint` fills for a frame of a form; None if there are too many."""
    skeleton = layout.skeleton
    positions = torch.randn(1, skeleton.num_joints, 3)
    rotations = torch.eye(3).expand(1, skeleton.num_joints, 3, 3)

    def mask(fill: object) -> torch.Tensor:
        targets = Targets(skeleton)
        fill(targets)  # type: ignore[operator]
        return targets.fill(layout, 0, 1)[1][0]

    if form in ("waypoints", "trajectory"):
        return [
            mask(lambda targets: targets.add_waypoints([0], torch.ones(1, 2))),
            mask(lambda targets: targets.add_waypoints([0], torch.ones(1, 2), torch.zeros(1))),
        ]
    if form in ("keyframes", "keyframe_block"):
        return [mask(lambda targets: targets.add_keyframes([0], positions))]
    if form not in ("planted_feet", "end_effectors"):
        return None
    limbs = ("LeftFoot", "RightFoot") if form == "planted_feet" else ("LeftHand", "RightHand", "LeftFoot", "RightFoot")
    chosen = [[limb for index, limb in enumerate(limbs) if bits >> index & 1] for bits in range(1, 1 << len(limbs))]
    told = [
        mask(lambda targets, some=some: targets.add_end_effectors([0], [*some, "Hips"], positions, rotations))
        for some in chosen
    ]
    hips = torch.zeros_like(told[0])
    hips[layout.rotation_block.start : layout.rotation_block.start + 6] = 1
    return [*told, *(columns * (1 - hips) for columns in told)]  # the hips' rotation is given in some rows only


@pytest.mark.parametrize("form", FORMS)
def test_constraints_in_training_fill_only_columns_used_at_run_time(form: str, layout: Representation) -> None:
    sampler = ConstraintSampler(layout, only(form))
    batch = 60
    spans = WindowSpans(
        torch.full((batch,), 8), torch.full((batch,), 48), torch.full((batch,), 80), torch.ones(batch, 80, 2).bool()
    )
    masks = sampler.sample(spans, torch.Generator().manual_seed(0))
    assert not masks[:, :8].any()
    rows = masks[masks.any(-1)]
    assert len(rows) >= batch // 2
    assert not rows[:, layout.velocity_block].any()
    assert not rows[:, layout.contact_block].any()
    allowed = columns_at_run_time(form, layout)
    if allowed is None:
        return
    if form in ("waypoints", "trajectory"):  # in some rows the root's height is given too
        rows = rows.clone()
        rows[:, 1] = False
    found = {tuple(row.tolist()) for row in rows}
    possible = {tuple((columns > 0).tolist()) for columns in allowed}
    assert found <= possible
    assert len(found) >= min(2, len(possible))


@pytest.mark.parametrize("horizon", [4, 8, 12, 16, 40])
def test_a_generated_history_is_complete_whatever_the_horizon(
    bank: FeatureBank, layout: Representation, horizon: int
) -> None:
    sampler = WindowSampler(bank, np.ones((len(bank.captions.texts), 8), np.float32), layout, horizon, batch=24)
    generator, any_used = torch.Generator().manual_seed(0), False
    for _ in range(20):
        batch = sampler.sample(OwnHistory(), generator)
        earlier = batch.earlier
        assert earlier is not None
        assert bool((earlier.first_token >= 0).all())
        for windows in (earlier.windows, batch):
            assert bool((windows.generation_len <= horizon).all())
            assert bool((windows.length <= windows.features.shape[1]).all())
        assert bool((batch.history_len[earlier.used] == sampler.own_history).all())
        tokens = [torch.zeros(len(each.length), each.features.shape[1] // 4, 8) for each in (earlier.windows, batch)]
        earlier.as_history(*tokens)
        any_used |= bool(earlier.used.any())
        # The windows meet: the last frame of the earlier one's horizon is that before the batch's own.
        rows = earlier.used.nonzero()[:, 0]
        ends = earlier.first_token[rows] * 4 + batch.history_len[rows] - 1
        shown, own = (layout.denormalize(each.features) for each in (earlier.windows, batch))
        body = slice(layout.rotation_block.start, layout.rotation_block.stop)
        torch.testing.assert_close(
            shown[rows, ends][:, body], own[rows, batch.history_len[rows] - 1][:, body], atol=1e-4, rtol=0
        )
    assert any_used


def test_a_horizon_too_long_for_a_window_is_refused(bank: FeatureBank, layout: Representation) -> None:
    embeddings = np.ones((len(bank.captions.texts), 8), np.float32)
    assert WindowSampler(bank, embeddings, layout, horizon=184, batch=24).shapes
    with pytest.raises(ConfigError, match=r"model\.horizon is 188; .* give at most 184"):
        WindowSampler(bank, embeddings, layout, horizon=188, batch=24)
