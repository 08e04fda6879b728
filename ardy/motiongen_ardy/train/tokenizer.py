"""Train the tokenizer: `python -m motiongen_ardy.train.tokenizer DATA OUT`.

Losses: reconstruction (smooth L1 on normalised features), foot skate (weight 0.01, as in the paper), consistency of
positions with rotations, for a VAE the divergence of its latents from a unit normal, and kinematics: joint positions,
velocities and rotations of the decoded motion, in world units. Positions alone would permit a thigh twisted about its
axis.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor, nn

from motiongen_ardy.checkpoint.checkpoint import save_tokenizer
from motiongen_ardy.checkpoint.config import MOTION_STATS
from motiongen_ardy.checkpoint.config_writer import check_tokenizer_config
from motiongen_ardy.checkpoint.stats import load_stats, save_stats
from motiongen_ardy.core.output import command
from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, ROOT_WIDTH, Representation
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.data.dataset import MotionDataset
from motiongen_ardy.model.config import TokenizerConfig
from motiongen_ardy.model.tokenizer import Tokenizer, build_tokenizer
from motiongen_ardy.train.feature_bank import FeatureBank, build_feature_bank, measure_stats, natural_layout
from motiongen_ardy.train.loop import Trainer
from motiongen_ardy.train.loop_settings import LoopSettings, add_loop_arguments, loop_settings
from motiongen_ardy.train.losses import captured_kinematics, consistency, kinematic_errors, kinematics, skate, smooth_l1
from motiongen_ardy.train.processes import distributed
from motiongen_ardy.train.recipe import read_recipe
from motiongen_ardy.train.refusals import UNUSABLE
from motiongen_ardy.train.run_folder import STATE_FILE, held, writing

WEIGHTS = {
    "reconstruction": 1.0,
    "consistency": 1.0,
    "skate": 0.01,
    "local_root": 0.1,
    "divergence": 1e-6,
    "joints": 4.0,
    "ends": 2.0,
    "speed": 0.3,
    "planted": 1.0,
    "turn": 0.5,
}
MIN_CROP_FRAMES = 12


@dataclass(frozen=True)
class Crop:
    """The shape of a batch: frames of every crop, and the chance that a batch has it."""

    frames: int
    chance: float


CROPS = (Crop(24, 0.2), Crop(64, 0.6), Crop(200, 0.2))


class TokenizerLoss(nn.Module):
    """The tokenizer with its training loss."""

    def __init__(self, tokenizer: Tokenizer) -> None:
        super().__init__()
        self.tokenizer = tokenizer

    def forward(self, batch: tuple[Tensor, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: normalised features (B, T, D) and valid frames (B, T) bool."""
        features, valid = batch
        tokenizer = self.tokenizer
        body, root = features[..., ROOT_WIDTH:], features[..., :ROOT_WIDTH]
        codes, divergence = self._codes(body, valid)
        decoded, local_root = tokenizer.decode_codes(codes, root, valid.sum(1), valid)
        with torch.autocast(features.device.type, enabled=False):
            parts = self._parts(features, decoded.float(), local_root.float(), valid)
        if divergence is not None:
            parts["divergence"] = divergence
        total = sum((WEIGHTS[name] * value for name, value in parts.items()), features.new_zeros(()))
        return total, {name: value.detach() for name, value in parts.items()}

    def _parts(self, features: Tensor, decoded: Tensor, local_root: Tensor, valid: Tensor) -> dict[str, Tensor]:
        layout = self.tokenizer.representation
        root = features[..., :ROOT_WIDTH]
        natural, true = layout.denormalize(torch.cat([root, decoded], dim=-1)), layout.denormalize(features)
        pose = kinematics(layout, natural)
        errors = kinematic_errors(
            layout, pose, captured_kinematics(layout, true), true[..., layout.contact_block], valid
        )
        return {
            "reconstruction": smooth_l1(decoded, features[..., ROOT_WIDTH:], valid),
            "consistency": consistency(layout, natural, pose, valid),
            "skate": skate(layout, natural, valid),
            "local_root": smooth_l1(local_root, layout.local_root(root, valid.sum(1)), valid),
            **errors._asdict(),
        }

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

    fingerprint = ""

    def __init__(self, config: TokenizerConfig, bank: FeatureBank, representation: Representation, batch: int) -> None:
        self.bank = bank
        self.representation = representation
        self.batch = batch
        self.patch = config.patch
        self.terms = {"skeleton": representation.skeleton.name, "frames a second": str(representation.fps)}
        self.module = TokenizerLoss(build_tokenizer(config, representation))

    def kinds(self, _progress: float) -> Sequence[tuple[Hashable, float]]:
        """Crops of every length, throughout the training."""
        return [(crop, crop.chance) for crop in CROPS]

    def sample(self, kind: Hashable, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
        """Normalised features (B, T, D) and valid frames (B, T); the number of frames is kept near 64 B."""
        if not isinstance(kind, Crop):
            raise TypeError(f"batches are drawn by crop, not by {kind!r}")
        device, num_frames = self.bank.device, kind.frames // self.patch * self.patch
        batch = max(1, self.batch * 64 // num_frames)
        clips = self.bank.draw_clips(batch, generator)
        length = self.bank.length[clips]
        # The start range extends 16 frames beyond the last full crop, so that clips can end within a crop.
        room = (length - num_frames + 16).clamp(min=1)
        starts = (torch.rand(batch, generator=generator, device=device) * room).long()
        starts = torch.minimum(starts, length - MIN_CROP_FRAMES)
        angle = (torch.rand(batch, generator=generator, device=device) * 2 - 1) * torch.pi
        frames = self.representation.rotate(self.bank.gather(clips, starts, num_frames), angle, orthonormal=True)
        frames = self.representation.translate_ground(frames, -frames[:, 0, 0:3:2])
        left = (length - starts) // self.patch * self.patch
        valid = torch.arange(num_frames, device=device) < left[:, None]
        return self.representation.normalize(frames), valid

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Write the tokenizer folder: weights, config, motion statistics, latent statistics."""
        if not isinstance(averaged, TokenizerLoss):
            raise TypeError(f"a tokenizer's training exports a TokenizerLoss, not a {type(averaged).__name__}")
        measure_latents(averaged.tokenizer, self, num_batches=24)
        save_tokenizer(averaged.tokenizer, folder)


@torch.no_grad()
def measure_latents(tokenizer: Tokenizer, task: TokenizerTask, num_batches: int) -> None:
    """Set the tokenizer's latent statistics, before and after quantisation, from random training crops."""
    device = task.bank.device
    generator = torch.Generator(device).manual_seed(1)
    raw = []
    for number in range(num_batches):
        features, valid = task.sample(CROPS[number % len(CROPS)], generator)
        latents = tokenizer.raw_latents(features[..., ROOT_WIDTH:], valid)
        raw.append(latents[valid[:, :: task.patch]].float())
    before = torch.cat(raw)
    after = tokenizer.quantizer.quantize(before) if tokenizer.config.kind == "fsq" else before
    tokenizer.pre_stats = Stats(before.mean(0), before.std(0))
    tokenizer.post_stats = Stats(after.mean(0), after.std(0))


def train_tokenizer(
    config: TokenizerConfig, dataset: MotionDataset, settings: LoopSettings, batch: int, device: str = "cpu"
) -> Trainer:
    """Train on a data set's clips and return the finished trainer; its folder holds the result."""
    with distributed() as (rank, num_processes), held(settings.out, rank):
        torch.manual_seed(settings.seed)
        dataset.require(dataset.skeleton.name, round(dataset.fps))  # a model's frame rate is a whole number
        check_tokenizer_config(config, dataset.skeleton.name, int(dataset.fps))
        layout = natural_layout(dataset.skeleton, int(dataset.fps))
        bank = build_feature_bank(dataset, layout, device=device)
        # A resumed run keeps the statistics with which its weights were trained. They are written before the first
        # weights, so that a run can be resumed whenever it is killed after that.
        if (settings.out / STATE_FILE).exists():
            stats = load_stats(settings.out / MOTION_STATS, dataset.skeleton.feature_dim + LOCAL_ROOT_WIDTH)
        else:
            stats = measure_stats(bank, layout)
            if rank == 0:
                with writing(settings.out):
                    save_stats(stats, settings.out / MOTION_STATS)
        representation = Representation(dataset.skeleton, int(dataset.fps), stats).to(device)
        task = TokenizerTask(config, bank, representation, batch)
        task.module.to(device)
        trainer = Trainer(task, settings, rank, num_processes)
        trainer.run()
        return trainer


def main(given: Sequence[str] | None = None) -> int:
    """Command line. Returns 0 when all steps are done, 3 when some are left, 2 for input that cannot be used."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.train.tokenizer", description=__doc__)
    add_loop_arguments(parser, steps=30_000, learning_rate=1e-3, batch=64)
    parser.add_argument("--config", type=Path, help="YAML with sections tokenizer, denoiser, model, loss")
    arguments = parser.parse_args(given)
    try:
        config = read_recipe(arguments.config).tokenizer
        dataset = MotionDataset.load(arguments.data, "train")
        return train_tokenizer(config, dataset, loop_settings(arguments), arguments.batch, arguments.device).exit_code
    except UNUSABLE as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(command(main))
