"""A few training steps of tokenizer and denoiser, run by test_distributed in two processes. Argument: the folder."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

from motiongen_ardy.checkpoint.checkpoint import load_tokenizer
from motiongen_ardy.model.config import TokenizerConfig, TransformerConfig
from motiongen_ardy.train.denoiser import denoiser_of, train_denoiser
from motiongen_ardy.train.loop_settings import LoopSettings
from motiongen_ardy.train.recipe import MINI_DENOISER
from motiongen_ardy.train.tokenizer import train_tokenizer
from tests.ardy.train.clips import swinging_dataset


def main() -> None:
    """Train both parts for three steps."""
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


if __name__ == "__main__":
    main()
