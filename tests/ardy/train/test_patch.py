"""Models with other patch sizes are trained, exported, loaded and rolled out."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, load_tokenizer
from motiongen_ardy.checkpoint.files import CheckpointError
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.train.denoiser import starting_model, train_denoiser
from motiongen_ardy.train.feature_bank import build_feature_bank, natural_layout
from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.recipe import read_recipe
from motiongen_ardy.train.tokenizer import train_tokenizer
from motiongen_ardy.train.windows import OwnHistory, WindowSampler
from tests.ardy.train.clips import swinging_dataset

RECIPE = """
tokenizer:
  patch: 5
  latent_dim: 8
  levels: 16
  transformer: {width: 16, feed_forward: 32, num_layers: 1, num_heads: 2}
denoiser: {text_dim: 8, transformer: {width: 16, feed_forward: 32, num_layers: 1, num_heads: 2}}
model: {horizon: 20, num_base_steps: 20}
"""


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkpoint folder of a few steps of training, with tokens of five frames."""
    folder = tmp_path_factory.mktemp("patch")
    (folder / "recipe.yaml").write_text(RECIPE)
    recipe = read_recipe(folder / "recipe.yaml")
    settings = LoopSettings(
        out=folder / "tokenizer", steps=2, learning_rate=1e-3, warmup_steps=1, log_every=1, bfloat16=False
    )
    dataset = swinging_dataset()
    train_tokenizer(recipe.tokenizer, dataset, settings, batch=1)
    model = starting_model(load_tokenizer(folder / "tokenizer"), recipe, None)
    train_denoiser(model, dataset, "hashed", replace(settings, out=folder / "denoiser", steps=4), 1, recipe)
    return folder / "denoiser"


def test_a_recipe_with_another_patch_gives_a_model_that_generates(trained: Path) -> None:
    read = load_checkpoint(trained)
    assert (read.config.patch, read.config.num_base_steps, read.config.token_width) == (5, 20, 33)
    targets = Targets(read.skeleton)
    targets.add_waypoints([49], torch.tensor([[0.5, 1.0]]))
    features = rollout(read, RolloutRequest(55, torch.zeros(8), num_steps=3, targets=targets))
    assert features.shape == (55, read.representation.feature_dim)
    assert bool(features.isfinite().all())


@pytest.mark.parametrize("patch", [1, 5, 10])
def test_windows_of_every_kind_are_whole_tokens(patch: int) -> None:
    dataset = swinging_dataset()
    layout = natural_layout(dataset.skeleton, 20)
    bank = build_feature_bank(dataset, layout)
    texts = np.zeros((len(bank.captions.texts), 8), np.float32)
    sampler = WindowSampler(bank, texts, layout, 20, 8, patch)
    for shape in (*sampler.shapes, OwnHistory()):
        batch = sampler.sample(shape, torch.Generator().manual_seed(0))
        for lengths in (batch.history_len, batch.generation_len, batch.length):
            assert bool((lengths % patch == 0).all())
        assert batch.features.shape[1] % patch == batch.num_known % patch == 0
        assert bool((batch.generation_len > 0).all())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"nframe_root_dim": 20}, "nframe_root_dim"),
        ({"num_frames_per_token": 4, "nframe_root_dim": 20}, r"denoiser\.patch is 4 but the tokenizer's is 5"),
        ({"num_frames_per_token": 0}, "num_frames_per_token"),
        ({"num_frames_per_token": 11}, "num_frames_per_token"),
    ],
)
def test_a_checkpoint_with_inconsistent_patch_sizes_is_refused(
    trained: Path, tmp_path: Path, changes: dict[str, int], message: str
) -> None:
    config = yaml.safe_load((trained / "config.yaml").read_text())
    assert (config["denoiser"]["num_frames_per_token"], config["denoiser"]["nframe_root_dim"]) == (5, 25)
    shutil.copytree(trained, tmp_path / "changed")
    config["denoiser"] |= changes
    (tmp_path / "changed" / "config.yaml").write_text(yaml.safe_dump(config))
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(tmp_path / "changed")
