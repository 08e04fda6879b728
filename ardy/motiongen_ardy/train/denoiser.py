"""Train the denoiser on a trained tokenizer: `python -m motiongen_ardy.train.denoiser DATA OUT --tokenizer RUN`.

Hybrid, decoded-body, goal and consistency losses with equal weights (paper, section 3.4). The tokenizer stays as it is.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import torch
import yaml
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.checkpoint import load_tokenizer, save_checkpoint
from motiongen_ardy.config import DenoiserConfig, ModelConfig, TransformerConfig
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.denoiser import build_denoiser
from motiongen_ardy.diffusion import cosine_schedule
from motiongen_ardy.model import Model
from motiongen_ardy.representation import ROOT_WIDTH
from motiongen_ardy.text import load_text_encoder
from motiongen_ardy.tokenizer import ExplicitBody
from motiongen_ardy.tokenizer.model import ROOT_TOKEN_WIDTH, Tokenizer, root_from_tokens
from motiongen_ardy.train.feature_bank import build_feature_bank, natural_layout
from motiongen_ardy.train.loop import LoopSettings, Trainer, add_loop_arguments, distributed, loop_settings
from motiongen_ardy.train.losses import consistency, masked_mean, smooth_l1
from motiongen_ardy.train.windows import TrainingWindows, WindowSampler
from motiongen_ardy.window import Window

TEXT_DIM = 256
MINI_DENOISER = DenoiserConfig(
    transformer=TransformerConfig(width=256, feed_forward=512, num_layers=5, num_heads=4),
    latent_dim=64,
    text_tokens=1,
    text_dim=TEXT_DIM,
)


class DenoiserLoss(nn.Module):
    """A denoiser with its training loss; the codec is frozen and its weights are no part of the training state."""

    def __init__(self, model: Model) -> None:
        super().__init__()
        self.denoiser = model.denoiser
        self.config = model.config
        self.schedule = cosine_schedule(model.config.num_base_steps)
        self._frozen = [model.codec]  # in a list, so that it is not registered as a submodule

    @property
    def codec(self) -> Tokenizer | ExplicitBody:
        return self._frozen[0]

    def forward(self, batch: TrainingWindows) -> tuple[Tensor, dict[str, Tensor]]:
        window = Window(
            history_len=batch.history_len,
            generation_len=batch.generation_len,
            num_frames=batch.features.shape[1],
            text=batch.text,
            heading=batch.heading,
            observed=batch.observed,
            mask=batch.mask,
        )
        known = batch.history_len + batch.generation_len
        num_known = int(known.max())
        valid_known = torch.arange(num_known, device=known.device) < known[:, None]
        with torch.no_grad():
            hybrid = self.codec.to_hybrid(batch.features[:, :num_known], valid_known).float()
        clean = functional.pad(hybrid, (0, 0, 0, window.num_tokens - hybrid.shape[1]))
        step = torch.randint(self.config.num_base_steps, known.shape).to(known.device)
        noisy = self.schedule.add_noise(clean, torch.randn_like(clean), step)
        horizon, history = window.generation_tokens[..., None], window.history_tokens[..., None]
        tokens = torch.where(horizon, noisy, clean * history)
        predicted = self.denoiser(tokens, step, window).float()
        return self._losses(predicted, clean, batch, window, valid_known)

    def _losses(
        self, predicted: Tensor, clean: Tensor, batch: TrainingWindows, window: Window, valid_known: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        num_known = valid_known.shape[1]
        tokens = predicted[:, : num_known // 4]
        root = root_from_tokens(tokens)
        codes = self.codec.denormalize_latents(tokens[..., ROOT_TOKEN_WIDTH:])
        body, _ = self.codec.decode_codes(codes, root, valid_known.sum(1), valid_known)
        features = torch.cat([root, body.float()], dim=-1)
        horizon = window.generation_frames[:, :num_known]
        target = batch.features[:, :num_known]
        goal_mask = batch.mask[:, :num_known] * horizon[..., None]
        goal_error = (goal_mask * (features - target)).abs().sum() / goal_mask.sum().clamp(min=1)
        layout = self.codec.representation
        parts = {
            "root": smooth_l1(
                predicted[..., :ROOT_TOKEN_WIDTH], clean[..., :ROOT_TOKEN_WIDTH], window.generation_tokens
            ),
            "latent": smooth_l1(
                predicted[..., ROOT_TOKEN_WIDTH:], clean[..., ROOT_TOKEN_WIDTH:], window.generation_tokens
            ),
            "decoded": masked_mean((features - target)[..., ROOT_WIDTH:].abs(), horizon),
            "goal": goal_error,
            "consistency": consistency(layout, layout.denormalize(features), horizon),
        }
        total = torch.stack(list(parts.values())).sum()
        return total, {name: value.detach() for name, value in parts.items()}


class DenoiserTask:
    """Draws windows and exports whole checkpoints."""

    def __init__(self, model: Model, sampler: WindowSampler) -> None:
        self.model = model
        self.sampler = sampler
        self.module = DenoiserLoss(model)

    def sample(self, generator: torch.Generator) -> TrainingWindows:
        """A batch of windows on the training device."""
        return self.sampler.sample(generator)

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write a checkpoint folder that holds the averaged denoiser and, if there is one, the tokenizer."""
        assert isinstance(averaged, DenoiserLoss)
        model = self.model
        save_checkpoint(Model(model.config, model.representation, averaged.denoiser, model.tokenizer), folder)


def train_denoiser(
    model: Model, dataset: MotionDataset, text_encoder: str, settings: LoopSettings, batch: int
) -> Trainer:
    """Train a model's denoiser where it lies and return the finished trainer; its folder holds the checkpoint."""
    with distributed() as (rank, num_processes):
        torch.manual_seed(settings.seed + rank)
        config = model.config
        bank = build_feature_bank(dataset, natural_layout(dataset.skeleton, config.fps))
        embeddings = load_text_encoder(text_encoder, config.denoiser.text_dim).encode(bank.texts)
        sampler = WindowSampler(bank, embeddings, model.representation, config.horizon, batch)
        trainer = Trainer(DenoiserTask(model, sampler), settings, rank, num_processes)
        trainer.run()
        return trainer


def denoiser_of(tokenizer: Tokenizer, config: DenoiserConfig, horizon: int) -> Model:
    """A model with a fresh denoiser on a trained tokenizer, on the tokenizer's device."""
    layout = tokenizer.representation
    model_config = ModelConfig(
        skeleton=layout.skeleton.name, fps=layout.fps, horizon=horizon, denoiser=config, tokenizer=tokenizer.config
    )
    denoiser = build_denoiser(config, layout).to(layout.stats.mean.device)
    return Model(model_config, layout, denoiser, tokenizer)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.denoiser", description=__doc__)
    add_loop_arguments(parser, steps=60_000, learning_rate=5e-4, batch=64)
    parser.add_argument("--tokenizer", type=Path, required=True, help="folder of a trained tokenizer")
    parser.add_argument("--text-encoder", default="static", help="static, hashed or a folder (default %(default)s)")
    parser.add_argument("--config", type=Path, help="YAML with DenoiserConfig fields to change, e.g. num_stages: 1")
    parser.add_argument("--horizon", type=int, default=40, help="frames a window generates (default %(default)s)")
    arguments = parser.parse_args()
    tokenizer = load_tokenizer(arguments.tokenizer, arguments.device)
    config = replace(MINI_DENOISER, latent_dim=tokenizer.config.latent_dim)
    if arguments.config is not None:
        config = replace(config, **yaml.safe_load(arguments.config.read_text(encoding="utf-8")))
    torch.manual_seed(arguments.seed)
    model = denoiser_of(tokenizer, config, arguments.horizon)
    dataset = MotionDataset.load(arguments.data, "train")
    train_denoiser(model, dataset, arguments.text_encoder, loop_settings(arguments), arguments.batch)


if __name__ == "__main__":
    main()
