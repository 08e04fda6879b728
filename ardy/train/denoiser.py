"""Train the denoiser on a trained tokenizer: `python -m ardy.train.denoiser DATA OUT --tokenizer RUN`.

Hybrid, decoded-body, goal and consistency losses with equal weights (paper, section 3.4). The tokenizer stays as it is.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn import functional

from ardy.checkpoint import load_tokenizer, save_checkpoint
from ardy.config import DenoiserConfig, ModelConfig, TransformerConfig
from ardy.data.dataset import MotionDataset
from ardy.denoiser import build_denoiser
from ardy.diffusion import cosine_schedule
from ardy.model import Model
from ardy.representation import ROOT_WIDTH
from ardy.text import load_text_encoder
from ardy.tokenizer.model import ROOT_TOKEN_WIDTH, Tokenizer, root_from_tokens
from ardy.train.feature_bank import build_feature_bank, natural_layout
from ardy.train.loop import LoopSettings, Trainer, add_loop_arguments, distributed, loop_settings
from ardy.train.losses import consistency, masked_mean, smooth_l1
from ardy.train.windows import TrainingWindows, WindowSampler
from ardy.window import Window

TEXT_DIM = 256
MINI_DENOISER = DenoiserConfig(
    transformer=TransformerConfig(width=256, feed_forward=512, num_layers=5, num_heads=4),
    latent_dim=64,
    text_tokens=1,
    text_dim=TEXT_DIM,
)


class DenoiserLoss(nn.Module):
    """A denoiser with its training loss; the tokenizer is frozen and its weights are no part of the training state."""

    def __init__(self, model: Model, tokenizer: Tokenizer) -> None:
        super().__init__()
        self.denoiser = model.denoiser
        self.config = model.config
        self.schedule = cosine_schedule(model.config.num_base_steps)
        self._frozen = [tokenizer]  # in a list, so that it is not registered as a submodule

    @property
    def tokenizer(self) -> Tokenizer:
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
            hybrid = self.tokenizer.to_hybrid(batch.features[:, :num_known], valid_known).float()
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
        codes = self.tokenizer.denormalize_latents(tokens[..., ROOT_TOKEN_WIDTH:])
        body, _ = self.tokenizer.decode_codes(codes, root, valid_known.sum(1), valid_known)
        features = torch.cat([root, body.float()], dim=-1)
        horizon = window.generation_frames[:, :num_known]
        target = batch.features[:, :num_known]
        goal_mask = batch.mask[:, :num_known] * horizon[..., None]
        goal_error = (goal_mask * (features - target)).abs().sum() / goal_mask.sum().clamp(min=1)
        layout = self.tokenizer.representation
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

    def __init__(self, model: Model, sampler: WindowSampler, tokenizer: Tokenizer) -> None:
        self.model = model
        self.sampler = sampler
        self.module = DenoiserLoss(model, tokenizer)

    def sample(self, generator: torch.Generator) -> TrainingWindows:
        """A batch of windows on the training device."""
        return self.sampler.sample(generator)

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write a checkpoint folder that holds the averaged denoiser and the tokenizer."""
        assert isinstance(averaged, DenoiserLoss)
        tokenizer = averaged.tokenizer
        save_checkpoint(Model(self.model.config, tokenizer.representation, averaged.denoiser, tokenizer), folder)


def train_denoiser(
    config: ModelConfig,
    tokenizer: Tokenizer,
    dataset: MotionDataset,
    text_encoder: str,
    settings: LoopSettings,
    batch: int,
) -> Trainer:
    """Train a denoiser on the tokenizer's device and return the finished trainer; its folder holds the checkpoint."""
    with distributed() as (rank, num_processes):
        torch.manual_seed(settings.seed + rank)
        bank = build_feature_bank(dataset, natural_layout(dataset.skeleton, config.fps))
        embeddings = load_text_encoder(text_encoder, config.denoiser.text_dim).encode(bank.texts)
        layout = tokenizer.representation
        device = layout.stats.mean.device
        model = Model(config, layout, build_denoiser(config.denoiser, layout).to(device), tokenizer)
        sampler = WindowSampler(bank, embeddings, layout, config.horizon, batch)
        trainer = Trainer(DenoiserTask(model, sampler, tokenizer), settings, rank, num_processes)
        trainer.run()
        return trainer


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m ardy.train.denoiser", description=__doc__)
    add_loop_arguments(parser, steps=60_000, learning_rate=5e-4, batch=64)
    parser.add_argument("--tokenizer", type=Path, required=True, help="folder of a trained tokenizer")
    parser.add_argument("--text-encoder", default="static", help="static, hashed or a folder (default %(default)s)")
    parser.add_argument("--horizon", type=int, default=40, help="frames a window generates (default %(default)s)")
    arguments = parser.parse_args()
    tokenizer = load_tokenizer(arguments.tokenizer, arguments.device)
    config = ModelConfig(
        skeleton=tokenizer.representation.skeleton.name,
        fps=tokenizer.representation.fps,
        horizon=arguments.horizon,
        denoiser=MINI_DENOISER,
        tokenizer=tokenizer.config,
    )
    dataset = MotionDataset.load(arguments.data, "train")
    train_denoiser(config, tokenizer, dataset, arguments.text_encoder, loop_settings(arguments), arguments.batch)


if __name__ == "__main__":
    main()
