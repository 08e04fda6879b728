"""A few training steps of tokenizer and denoiser, run by test_distributed in two processes. Argument: the folder.

Each process writes the weights that it ends with, and the gradient of a step of which the answer is known.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Hashable, Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor, nn

from motiongen_ardy.checkpoint.checkpoint import load_tokenizer
from motiongen_ardy.model.config import TokenizerConfig, TransformerConfig
from motiongen_ardy.train.denoiser import denoiser_of, train_denoiser
from motiongen_ardy.train.loop import Trainer
from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.processes import distributed
from motiongen_ardy.train.recipe import MINI_DENOISER
from motiongen_ardy.train.tokenizer import train_tokenizer
from tests.ardy.train.clips import swinging_dataset


class Scaled(nn.Module):
    """One weight, which begins as `start`; the loss is the batch times it, so the batch is its gradient."""

    def __init__(self, start: float) -> None:
        super().__init__()
        self.weight = nn.Parameter(torch.tensor([start]))

    def forward(self, batch: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        return (batch * self.weight).sum(), {}


class OneNumber:
    """A task whose batches are a number that differs from process to process, as does the weight it begins with."""

    fingerprint = ""
    terms: dict[str, str] = {}  # noqa: RUF012  as the protocol has it

    def __init__(self, rank: int) -> None:
        self.module = Scaled(float(rank))
        self._rank = rank

    def kinds(self, progress: float) -> Sequence[tuple[Hashable, float]]:
        return [("one", 1.0)]

    def sample(self, kind: Hashable, generator: torch.Generator | None) -> Tensor:
        return torch.tensor([1.0 + 2.0 * self._rank])

    def export(self, averaged: nn.Module, folder: Path) -> None:
        """Nothing is kept of it."""


def main() -> None:
    """Train both parts for three steps, and a single weight for one."""
    out = Path(sys.argv[1])
    small = TransformerConfig(width=16, feed_forward=32, num_layers=1, num_heads=2)
    settings = LoopSettings(out=out / "tokenizer", steps=3, learning_rate=1e-3, warmup_steps=1, bfloat16=False)
    config = TokenizerConfig(transformer=small, latent_dim=8, levels=(16,) * 8)
    dataset = swinging_dataset()
    train_tokenizer(config, dataset, settings, batch=1)
    model = denoiser_of(
        load_tokenizer(settings.out), replace(MINI_DENOISER, transformer=small, latent_dim=8, text_dim=8), horizon=16
    )
    train_denoiser(model, dataset, "hashed", replace(settings, out=out / "denoiser"), batch=2)
    with distributed() as (rank, num_processes):
        torch.save(model.denoiser.state_dict(), out / f"weights-{rank}.pt")
        task = OneNumber(rank)
        step = Trainer(task, replace(settings, out=out / "number"), rank, num_processes).train_step()
        told = {"gradient": float(step["gradient"]), "weight": float(task.module.weight)}
        (out / f"step-{rank}.json").write_text(json.dumps(told), encoding="utf-8")


if __name__ == "__main__":
    main()
