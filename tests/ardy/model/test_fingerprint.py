"""A model's fingerprint: the same wherever the same model is loaded, another if any of its numbers differ."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.fingerprint import fingerprint
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.sampling.paces import PromptPaces
from tests.ardy.conftest import GoldenModel

WIDTH = 8


def model_of(golden: GoldenModel) -> Model:
    model = load_checkpoint(golden.folder / "checkpoint")
    texts = torch.eye(2, WIDTH)
    model.paces = PromptPaces(
        torch.zeros(WIDTH), texts, torch.tensor([[0.0, 1.0]] * 2), 0.25, texts, torch.tensor([0.0, 1.0]), torch.zeros(2)
    )
    return model


def retrain(model: Model) -> None:
    next(model.denoiser.parameters()).mul_(1.001)


def change_last_weight(model: Model) -> None:
    """The last number of the largest tensor, as in a table of which some rows were trained."""
    max(model.denoiser.parameters(), key=torch.numel).flatten()[-1].add_(0.5)


def change_last_mean(model: Model) -> None:
    model.representation.stats.mean[-1] += 0.5


def change_one_std(model: Model) -> None:
    model.representation.feature_stats.std[0] *= 2


def change_guidance(model: Model) -> None:
    guidance = replace(model.sampling.guidance, text=model.sampling.guidance.text / 2)
    model.sampling = replace(model.sampling, guidance=guidance)


def change_schedule(model: Model) -> None:
    model.config = replace(model.config, num_base_steps=2 * model.config.num_base_steps)


def change_threshold_of_paces(model: Model) -> None:
    assert model.paces is not None
    model.paces = replace(model.paces, threshold=0.5)


def change_speeds_of_paces(model: Model) -> None:
    assert model.paces is not None
    model.paces.speeds[-1, -1] = 2.0


def drop_paces(model: Model) -> None:
    model.paces = None


def test_models_loaded_from_the_same_files_have_the_same_fingerprint(golden: GoldenModel) -> None:
    assert fingerprint(model_of(golden)) == fingerprint(model_of(golden))


@pytest.mark.parametrize(
    "change",
    [
        retrain,
        change_last_weight,
        change_last_mean,
        change_one_std,
        change_guidance,
        change_schedule,
        change_threshold_of_paces,
        change_speeds_of_paces,
        drop_paces,
    ],
)
def test_model_that_differs_in_anything_has_another_fingerprint(
    golden: GoldenModel, change: Callable[[Model], None]
) -> None:
    model = model_of(golden)
    before = fingerprint(model)
    with torch.no_grad():
        change(model)
    assert fingerprint(model) != before
