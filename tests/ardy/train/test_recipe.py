"""Training configurations: what they may change, and what is refused."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import pytest

from motiongen_ardy.model.config import ConfigError
from motiongen_ardy.train.recipe import MINI_DENOISER, MINI_TOKENIZER, Recipe, read_recipe


def written(folder: Path, text: str) -> Path:
    path = folder / "recipe.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_a_file_the_recipe_is_that_of_the_built_in_model() -> None:
    assert read_recipe(None) == Recipe(MINI_TOKENIZER, MINI_DENOISER)


def test_the_built_in_configuration_file_is_that_recipe() -> None:
    recipe = read_recipe(Path(str(resources.files("motiongen_ardy") / "train/configs/mini.yaml")))
    assert (recipe.tokenizer, recipe.denoiser, recipe.horizon) == (MINI_TOKENIZER, MINI_DENOISER, 40)


def test_the_configuration_of_the_paper_has_its_sizes() -> None:
    recipe = read_recipe(Path(str(resources.files("motiongen_ardy") / "train/configs/paper.yaml")))
    assert recipe.tokenizer.latent_dim == recipe.denoiser.latent_dim == 128
    assert recipe.tokenizer.levels == (64,) * 128
    assert recipe.tokenizer.transformer.width == 512
    assert recipe.tokenizer.transformer.num_layers == 8


def test_base_steps_horizon_and_loss_weights_can_be_set(tmp_path: Path) -> None:
    recipe = read_recipe(written(tmp_path, "model: {num_base_steps: 100, horizon: 16}\nloss: {planted: 2}\n"))
    assert (recipe.num_base_steps, recipe.horizon) == (100, 16)
    assert recipe.loss.planted == 2


def test_the_denoiser_takes_the_patch_of_the_tokenizer(tmp_path: Path) -> None:
    recipe = read_recipe(written(tmp_path, "tokenizer: {patch: 5}\n"))
    assert (recipe.tokenizer.patch, recipe.denoiser.patch) == (5, 5)


def test_files_are_found_beside_the_recipe(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("x: 1\n", encoding="utf-8")
    recipe = read_recipe(written(tmp_path, "files: {sampling.yaml: mine.yaml}\n"))
    assert recipe.files == (("sampling.yaml", tmp_path / "mine.yaml"),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("denoizer: {}\n", "unknown keys denoizer; known keys are tokenizer"),
        ("denoiser: {transformer: {depth: 3}}\n", r"denoiser\.transformer has unknown keys depth"),
        ("denoiser: {transformer: 3}\n", r"denoiser\.transformer is 3; it must be a mapping"),
        ("denoiser: {text_tokens: many}\n", r"denoiser\.text_tokens is 'many'"),
        ("model: {horizon: 2.5}\n", r"model\.horizon is 2\.5; it must be a whole number"),
        ("tokenizer: {transformer: {width: 13}}\n", "width is 13"),
        ("tokenizer: {patch: 0}\n", "a token has 1 to 10 frames"),
        ("tokenizer: {patch: 11}\n", "a token has 1 to 10 frames"),
        ("files: {../evil.yaml: recipe.yaml}\n", "plain name"),
        ("files: {sampling.yaml: absent.yaml}\n", "a file that lies in"),
        ("- 1\n", "must be a mapping"),
        ("a: [\n", "is not readable YAML"),
        ("loss: {goal: 2020-13-01}\n", "is not readable YAML"),
        ("[" * 1000, "nested too deeply"),
        ("loss: {goal: 1, goal: 2}\n", "gives the keys 'goal' twice"),
        ("tokenizer: {levels: 64, latent_dim: many}\n", r"tokenizer\.latent_dim is 'many'; it must be a whole number"),
        ("files: {1: recipe.yaml}\n", r"files\.1 is 'recipe.yaml'; give a plain name"),
    ],
)
def test_invalid_recipes_are_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        read_recipe(written(tmp_path, text))
