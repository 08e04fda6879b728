"""Train the tokenizer: `python -m motiongen_ardy.train.tokenizer DATA OUT`.

Reconstruction (smooth L1 on normalised features), foot skate (weight 0.01, as in the paper), consistency of positions
with rotations, and for a VAE the divergence of its latents from a unit normal.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import yaml
from torch import Tensor, nn

from motiongen_ardy.checkpoint import save_tokenizer
from motiongen_ardy.config import TokenizerConfig, TransformerConfig
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.representation import ROOT_WIDTH, Representation
from motiongen_ardy.stats import Stats
from motiongen_ardy.tokenizer import Tokenizer, build_tokenizer
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, measure_stats, natural_layout
from motiongen_ardy.train.loop import LoopSettings, Trainer, add_loop_arguments, distributed, loop_settings
from motiongen_ardy.train.losses import consistency, skate, smooth_l1

SKATE_WEIGHT = 0.01
DIVERGENCE_WEIGHT = 1e-4
LOCAL_ROOT_WEIGHT = 0.1
CROP_FRAMES = (24, 40, 64, 96, 200)
CROP_CHANCES = (0.15, 0.25, 0.3, 0.2, 0.1)

MINI_TOKENIZER = TokenizerConfig(
    transformer=TransformerConfig(width=128, feed_forward=512, num_layers=4, num_heads=4),
    latent_dim=64,
    levels=(64,) * 64,
)


class TokenizerLoss(nn.Module):
    """The tokenizer with its training loss."""

    def __init__(self, tokenizer: Tokenizer) -> None:
        super().__init__()
        self.tokenizer = tokenizer

    def forward(self, batch: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: normalised features (B, T, D) and valid frames (B, T) bool."""
        features, valid = batch
        tokenizer, representation = self.tokenizer, self.tokenizer.representation
        body, root = features[..., ROOT_WIDTH:], features[..., :ROOT_WIDTH]
        codes, divergence = self._codes(body, valid)
        lengths = valid.sum(1)
        decoded, local_root = tokenizer.decode_codes(codes, root, lengths, valid)
        decoded = decoded.float()
        natural = representation.denormalize(torch.cat([root, decoded], dim=-1))
        parts = {
            "reconstruction": smooth_l1(decoded, body, valid),
            "consistency": consistency(representation, natural, valid),
            "skate": skate(representation, natural, valid),
            "local_root": smooth_l1(local_root.float(), representation.local_root(root, lengths), valid),
        }
        total = parts["reconstruction"] + parts["consistency"] + SKATE_WEIGHT * parts["skate"]
        total = total + LOCAL_ROOT_WEIGHT * parts["local_root"]
        if divergence is not None:
            parts["divergence"] = divergence
            total = total + DIVERGENCE_WEIGHT * divergence
        return total, {name: value.detach() for name, value in parts.items()}

    def _codes(self, body: Tensor, valid: Tensor) -> tuple[Tensor, Tensor | None]:
        if self.tokenizer.config.kind == "vae":
            mean, log_variance = (part.float() for part in self.tokenizer.posterior(body, valid))
            noise = torch.randn_like(mean)
            divergence = -0.5 * (1 + log_variance - mean.square() - log_variance.exp()).mean()
            return mean + noise * (0.5 * log_variance).exp(), divergence
        latents = self.tokenizer.raw_latents(body, valid).float()
        return (self.tokenizer.quantizer.quantize(latents) if self.tokenizer.config.kind == "fsq" else latents), None


class TokenizerTask:
    """Draws random crops, 1 to 10 s long, turned at random; exports weights with the latents' statistics."""

    def __init__(self, config: TokenizerConfig, bank: FeatureBank, representation: Representation, batch: int) -> None:
        self.bank = bank
        self.representation = representation
        self.batch = batch
        self.module = TokenizerLoss(build_tokenizer(config, representation))

    def sample(self, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Normalised features (B, T, D) and valid frames (B, T); the number of frames is kept near 64 B."""
        seed = int(torch.randint(2**62, (), generator=generator))
        random = np.random.default_rng(seed)
        num_frames = int(random.choice(CROP_FRAMES, p=CROP_CHANCES))
        batch = max(1, self.batch * 64 // num_frames)
        clips = random.choice(self.bank.num_clips, size=batch, p=self.bank.weight)
        # Starting up to 16 frames before the last possible crop's end lets clips end inside a crop.
        room = np.maximum(1, self.bank.length[clips] - num_frames + 16)
        starts = np.minimum((random.random(batch) * room).astype(np.int64), self.bank.length[clips] - 12)
        angle = torch.from_numpy(random.uniform(-np.pi, np.pi, batch)).float()
        frames = self.representation.rotate(self.bank.gather(clips, starts, num_frames), angle, orthonormal=True)
        frames = self.representation.translate_ground(frames, -frames[:, 0, [0, 2]])
        left = (self.bank.length[clips] - starts) // 4 * 4  # whole tokens
        valid = torch.from_numpy(np.arange(num_frames) < left[:, None])
        device = self.representation.stats.mean.device
        return self.representation.normalize(frames.to(device)), valid.to(device)

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write the tokenizer folder: weights, config, motion statistics, latent statistics."""
        assert isinstance(averaged, TokenizerLoss)
        measure_latents(averaged.tokenizer, self, num_batches=24)
        save_tokenizer(averaged.tokenizer, folder)


@torch.no_grad()
def measure_latents(tokenizer: Tokenizer, task: TokenizerTask, num_batches: int) -> None:
    """Set the tokenizer's latent statistics, before and after quantisation, from random training crops."""
    generator = torch.Generator().manual_seed(1)
    raw = []
    for _ in range(num_batches):
        features, valid = task.sample(generator)
        latents = tokenizer.raw_latents(features[..., ROOT_WIDTH:], valid)
        raw.append(latents[valid[:, ::4]].float())
    before = torch.cat(raw)
    after = tokenizer.quantizer.quantize(before) if tokenizer.config.kind == "fsq" else before
    tokenizer.pre_stats = Stats(before.mean(0), before.std(0))
    tokenizer.post_stats = Stats(after.mean(0), after.std(0))


def train_tokenizer(
    config: TokenizerConfig, dataset: MotionDataset, settings: LoopSettings, batch: int, device: str = "cpu"
) -> Trainer:
    """Train on a data set's clips and return the finished trainer; its folder holds the result."""
    with distributed() as (rank, num_processes):
        torch.manual_seed(settings.seed)
        layout = natural_layout(dataset.skeleton, int(dataset.fps))
        bank = build_feature_bank(dataset, layout)
        representation = Representation(dataset.skeleton, int(dataset.fps), measure_stats(bank, layout))
        task = TokenizerTask(config, bank, representation, batch)
        task.module.to(device)
        trainer = Trainer(task, settings, rank, num_processes)
        trainer.run()
        return trainer


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.tokenizer", description=__doc__)
    add_loop_arguments(parser, steps=30_000, learning_rate=1e-3, batch=64)
    parser.add_argument("--config", type=Path, help="YAML with TokenizerConfig fields to change, e.g. kind: vae")
    arguments = parser.parse_args()
    config = MINI_TOKENIZER
    if arguments.config is not None:
        config = replace(config, **yaml.safe_load(arguments.config.read_text(encoding="utf-8")))
    dataset = MotionDataset.load(arguments.data, "train")
    train_tokenizer(config, dataset, loop_settings(arguments), arguments.batch, arguments.device)


if __name__ == "__main__":
    main()
