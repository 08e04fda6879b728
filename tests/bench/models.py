"""The models to measure: the built-in one, a checkpoint, or random weights of the released size or a tiny one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.core.skeleton import load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import DenoiserConfig, ModelConfig, TokenizerConfig, TransformerConfig
from motiongen_ardy.model.model import Model, build_model
from motiongen_server.engine.types import Float32Array
from tests.bench.prompts import PROMPTS

BUILT_IN = "motiongen-mini"
SEED = 7


def _config(denoiser: TransformerConfig, tokenizer: TransformerConfig, latent: int, text: int) -> ModelConfig:
    return ModelConfig(
        skeleton="core27",
        fps=20,
        horizon=40,
        denoiser=DenoiserConfig(denoiser, latent_dim=latent, text_tokens=1, text_dim=text),
        tokenizer=TokenizerConfig(tokenizer, latent_dim=latent, levels=(64,) * latent),
    )


RANDOM_WEIGHTS = {
    # The sizes of the released Core-Horizon40: 156 million parameters in the denoiser, 35 million in the tokenizer.
    "full": _config(TransformerConfig(1024, 2048, 8, 8), TransformerConfig(512, 1024, 8, 4), latent=128, text=4096),
    "tiny": _config(TransformerConfig(64, 128, 2, 4), TransformerConfig(48, 80, 2, 4), latent=16, text=32),
}


@dataclass(frozen=True)
class BenchModel:
    """A model, its name in tables, and embeddings of prompts for it."""

    name: str
    model: Model
    embeddings: Sequence[Float32Array]


def bench_model(name: str, device: str = "cpu") -> BenchModel:
    """The model of a checkpoint folder, the built-in one by its name, or random weights: "full" or "tiny".

    Random weights need no files, and no libraries but torch and numpy. Raises what `load_checkpoint` raises.
    """
    if name in RANDOM_WEIGHTS:
        config = RANDOM_WEIGHTS[name]
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(SEED)
            width = load_skeleton(config.skeleton).feature_dim + LOCAL_ROOT_WIDTH
            model = build_model(config, Stats(torch.zeros(width), torch.ones(width)))
        random = np.random.default_rng(SEED)
        embeddings = random.standard_normal((len(PROMPTS), config.denoiser.text_dim)).astype(np.float32)
        return BenchModel(f"random weights, {name}", ready(model, device), list(embeddings))
    # Imported here, so that random weights can be measured without the libraries that checkpoints need.
    from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
    from motiongen_ardy.checkpoint.model_card import model_folder
    from motiongen_ardy.text import load_text_encoder

    model = load_checkpoint(model_folder(name) if name == BUILT_IN else Path(name), device)
    encoder = load_text_encoder("static", model.config.denoiser.text_dim)
    return BenchModel(name, model, list(encoder.encode(list(PROMPTS))))


def ready(model: Model, device: str) -> Model:
    return model.to(device).eval().requires_grad_(False)
