"""Tokens of other lengths are trained, exported, read again and rolled out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
import yaml

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, load_tokenizer
from motiongen_ardy.checkpoint.files import CheckpointError
from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.model.rollout import RolloutRequest, rollout
from motiongen_ardy.train.denoiser import OWN_HISTORY_FROM, starting_model, train_denoiser
from motiongen_ardy.train.loop import LoopSettings
from motiongen_ardy.train.recipe import read_recipe
from motiongen_ardy.train.tokenizer import train_tokenizer
from tests.ardy.train.clips import swinging_dataset

RECIPE = """
tokenizer:
  patch: PATCH
  latent_dim: 8
  levels: 16
  transformer: {width: 16, feed_forward: 32, num_layers: 1, num_heads: 2}
denoiser: {text_dim: 8, transformer: {width: 16, feed_forward: 32, num_layers: 1, num_heads: 2}}
model: {horizon: 20, num_base_steps: 20}
"""


@pytest.mark.parametrize("patch", [2, 5, 10])
def test_a_recipe_with_another_patch_becomes_a_model_that_moves(tmp_path: Path, patch: int) -> None:
    (tmp_path / "recipe.yaml").write_text(RECIPE.replace("PATCH", str(patch)))
    recipe = read_recipe(tmp_path / "recipe.yaml")
    settings = LoopSettings(
        out=tmp_path / "tokenizer", steps=3, learning_rate=1e-3, warmup_steps=1, log_every=1, bfloat16=False
    )
    dataset = swinging_dataset()
    train_tokenizer(recipe.tokenizer, dataset, settings, batch=2)
    model = starting_model(load_tokenizer(tmp_path / "tokenizer"), recipe, None)
    assert OWN_HISTORY_FROM < 1
    train_denoiser(model, dataset, "hashed", replace(settings, out=tmp_path / "denoiser", steps=8), 2, recipe)
    read = load_checkpoint(tmp_path / "denoiser")
    assert (read.config.patch, read.config.num_base_steps, read.config.token_width) == (patch, 20, 5 * patch + 8)
    targets = Targets(read.skeleton)
    targets.add_waypoints([49], torch.tensor([[0.5, 1.0]]))
    features = rollout(read, RolloutRequest(55, torch.zeros(8), num_steps=3, targets=targets))
    assert features.shape == (55, read.representation.feature_dim)
    assert bool(features.isfinite().all())


def test_a_folder_whose_parts_disagree_on_the_patch_is_refused(tmp_path: Path) -> None:
    (tmp_path / "recipe.yaml").write_text(RECIPE.replace("PATCH", "5"))
    recipe = read_recipe(tmp_path / "recipe.yaml")
    settings = LoopSettings(
        out=tmp_path / "tokenizer", steps=1, learning_rate=1e-3, warmup_steps=1, log_every=1, bfloat16=False
    )
    train_tokenizer(recipe.tokenizer, swinging_dataset(), settings, batch=2)
    model = starting_model(load_tokenizer(tmp_path / "tokenizer"), recipe, None)
    train_denoiser(model, swinging_dataset(), "hashed", replace(settings, out=tmp_path / "denoiser"), 2, recipe)
    config = yaml.safe_load((tmp_path / "denoiser" / "config.yaml").read_text())
    assert (config["denoiser"]["num_frames_per_token"], config["denoiser"]["nframe_root_dim"]) == (5, 25)
    for changes, message in (
        ({"nframe_root_dim": 20}, "nframe_root_dim"),
        ({"num_frames_per_token": 4, "nframe_root_dim": 20}, "denoiser.patch is 4 but the tokenizer's is 5"),
        ({"num_frames_per_token": 0}, "num_frames_per_token"),
        ({"num_frames_per_token": 11}, "num_frames_per_token"),
    ):
        changed = config | {"denoiser": config["denoiser"] | changes}
        (tmp_path / "denoiser" / "config.yaml").write_text(yaml.safe_dump(changed))
        with pytest.raises(CheckpointError, match=message):
            load_checkpoint(tmp_path / "denoiser")
