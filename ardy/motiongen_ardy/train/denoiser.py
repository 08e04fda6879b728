"""Train the denoiser on a trained tokenizer: `python -m motiongen_ardy.train.denoiser DATA OUT --tokenizer RUN`.

The tokenizer is not changed. After a share of OWN_HISTORY_FROM of the training, some batches start from windows that
the model generated itself, as they do in service.
"""

from __future__ import annotations

import argparse
import hashlib
import shutil
import sys
from collections.abc import Hashable, Sequence
from pathlib import Path

import torch
from torch import nn

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint, load_tokenizer, save_checkpoint
from motiongen_ardy.checkpoint.config_writer import check_model_config
from motiongen_ardy.core.output import command
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.model.config import ConfigError, DenoiserConfig, ModelConfig
from motiongen_ardy.model.denoiser import build_denoiser
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.tokenizer.model import Tokenizer
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.train.denoiser_loss import DenoiserLoss
from motiongen_ardy.train.feature_bank import build_feature_bank, natural_layout
from motiongen_ardy.train.loop import Trainer
from motiongen_ardy.train.loop_settings import LoopSettings, add_loop_arguments, loop_settings
from motiongen_ardy.train.processes import distributed
from motiongen_ardy.train.recipe import Recipe, read_recipe
from motiongen_ardy.train.refusals import UNUSABLE
from motiongen_ardy.train.run_folder import held
from motiongen_ardy.train.windows import OwnHistory, TrainingWindows, WindowSampler, WindowShape

OWN_HISTORY_FROM = 0.3
OWN_HISTORY_CHANCE = 0.3


class DenoiserTask:
    """Draws windows, and exports whole checkpoints."""

    def __init__(self, model: Model, sampler: WindowSampler, recipe: Recipe, text_encoder: str = "") -> None:
        """text_encoder: the identity of the encoder of the sampler's vectors; "" if unknown."""
        self.model = model
        self.sampler = sampler
        self.files = recipe.files
        self.module = DenoiserLoss(model, recipe.loss)
        self.terms = {"text encoder": text_encoder} if text_encoder else {}
        self.fingerprint = "" if model.tokenizer is None else fingerprint_of(model.tokenizer)

    def kinds(self, progress: float) -> Sequence[tuple[Hashable, float]]:
        """The windows' shapes and, later in the training, windows that start from the model's own motion."""
        shapes = [(shape, shape.chance) for shape in self.sampler.shapes]
        if progress < OWN_HISTORY_FROM:
            return shapes
        own = OWN_HISTORY_CHANCE * sum(chance for _, chance in shapes)
        return [*shapes, (OwnHistory(), own)]

    def sample(self, kind: Hashable, generator: torch.Generator | None) -> TrainingWindows:
        """A batch of windows on the training device."""
        if not isinstance(kind, WindowShape | OwnHistory):
            raise TypeError(f"batches are drawn by window shape, not by {kind!r}")
        return self.sampler.sample(kind, generator)

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write a checkpoint folder: the averaged denoiser, the tokenizer if there is one, the recipe's files."""
        if not isinstance(averaged, DenoiserLoss):
            raise TypeError(f"a denoiser's training exports a DenoiserLoss, not a {type(averaged).__name__}")
        model = self.model
        save_checkpoint(Model(model.config, model.representation, averaged.denoiser, model.tokenizer), folder)
        for name, source in self.files:
            shutil.copyfile(source, folder / name)


def fingerprint_of(tokenizer: Tokenizer) -> str:
    """A hash of a tokenizer's weights, without the statistics of latents, which every export measures anew."""
    digest = hashlib.sha256()
    for name, tensor in sorted(tokenizer.state_dict().items()):
        digest.update(f"{name} {tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().cpu().float().contiguous().numpy().tobytes())
    return digest.hexdigest()


def train_denoiser(
    model: Model,
    dataset: MotionDataset,
    text_encoder: str,
    settings: LoopSettings,
    batch: int,
    recipe: Recipe | None = None,
) -> Trainer:
    """Train a model's denoiser in place and return the finished trainer; its folder holds the checkpoint."""
    with distributed() as (rank, num_processes), held(settings.out, rank):
        torch.manual_seed(settings.seed + rank)
        config = model.config
        dataset.require(config.skeleton, config.fps)
        check_model_config(config)
        device = model.representation.stats.mean.device
        bank = build_feature_bank(dataset, natural_layout(dataset.skeleton, config.fps), device=device)
        encoder = load_text_encoder(text_encoder, config.denoiser.text_dim)
        embeddings = encoder.encode(bank.captions.texts)
        sampler = WindowSampler(bank, embeddings, model.representation, config.horizon, batch, config.patch)
        task = DenoiserTask(model, sampler, recipe or Recipe(), encoder.identity)
        trainer = Trainer(task, settings, rank, num_processes)
        trainer.run()
        return trainer


def denoiser_of(tokenizer: Tokenizer, config: DenoiserConfig, horizon: int, num_base_steps: int = 10) -> Model:
    """A model with a fresh denoiser on a trained tokenizer, on the tokenizer's device."""
    layout = tokenizer.representation
    model_config = ModelConfig(
        skeleton=layout.skeleton.name,
        fps=layout.fps,
        horizon=horizon,
        denoiser=config,
        tokenizer=tokenizer.config,
        num_base_steps=num_base_steps,
    )
    denoiser = build_denoiser(config, layout).to(layout.stats.mean.device)
    return Model(model_config, layout, denoiser, tokenizer)


def starting_model(tokenizer: Tokenizer, recipe: Recipe, init: Path | None) -> Model:
    """A model with a fresh denoiser, or with that of a checkpoint. Raises CheckpointError or ConfigError."""
    model = denoiser_of(tokenizer, recipe.denoiser, recipe.horizon, recipe.num_base_steps)
    if init is not None:
        given = load_checkpoint(init).denoiser
        if given.config != model.denoiser.config:
            raise ConfigError(
                f"{init} has a denoiser of other sizes: {given.config}; the recipe's is {recipe.denoiser}"
            )
        model.denoiser.load_state_dict(given.state_dict())
    return model


def main(given: Sequence[str] | None = None) -> int:
    """Command line. Returns 0 when all steps are done, 3 when some are left, 2 for a run that cannot continue."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.denoiser", description=__doc__)
    add_loop_arguments(parser, steps=60_000, learning_rate=5e-4, batch=64)
    parser.add_argument("--tokenizer", type=Path, required=True, help="folder of a trained tokenizer")
    parser.add_argument("--text-encoder", default="static", help="static, hashed or a folder (default %(default)s)")
    parser.add_argument("--config", type=Path, help="YAML with sections tokenizer, denoiser, model, loss")
    parser.add_argument("--init", type=Path, help="checkpoint folder whose denoiser the training starts from")
    arguments = parser.parse_args(given)
    try:
        recipe = read_recipe(arguments.config)
        with distributed():  # before anything is put on a device: it determines which GPU "cuda" means in this process
            tokenizer = load_tokenizer(arguments.tokenizer, arguments.device)
            torch.manual_seed(arguments.seed)
            model = starting_model(tokenizer, recipe, arguments.init)
            dataset = MotionDataset.load(arguments.data, "train")
            settings = loop_settings(arguments)
            return train_denoiser(model, dataset, arguments.text_encoder, settings, arguments.batch, recipe).exit_code
    except UNUSABLE as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(command(main))
