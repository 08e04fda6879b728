"""Variants of a model that configurations allow: the paper's ablations, and others that public checkpoints may use."""

from __future__ import annotations

from dataclasses import replace

from motiongen_ardy.model.config import ModelConfig

VARIANTS = (
    "one stage",
    "explicit",
    "explicit, one stage",
    "autoencoder",
    "variational autoencoder",
    "global root decoder",
    "continuous latents",
    "no goals",
    "plain positions",
    "regular guidance",
    "no guidance",
    "norms first",
    "rectified",
)


def varied(config: ModelConfig, variant: str, body_dim: int) -> ModelConfig:
    """A configuration with one thing changed; body_dim: of the skeleton's features."""
    denoiser, tokenizer = config.denoiser, config.tokenizer
    assert tokenizer is not None
    layers = denoiser.transformer
    explicit = replace(config, tokenizer=None, denoiser=replace(denoiser, latent_dim=4 * body_dim))
    return {
        "one stage": replace(config, denoiser=replace(denoiser, num_stages=1)),
        "explicit": explicit,
        "explicit, one stage": replace(explicit, denoiser=replace(explicit.denoiser, num_stages=1)),
        "autoencoder": replace(config, tokenizer=replace(tokenizer, kind="ae")),
        "variational autoencoder": replace(config, tokenizer=replace(tokenizer, kind="vae")),
        "global root decoder": replace(config, tokenizer=replace(tokenizer, global_root=True)),
        "continuous latents": replace(config, tokenizer=replace(tokenizer, quantize_on_encode=False)),
        "no goals": replace(config, denoiser=replace(denoiser, constraints=False)),
        "plain positions": replace(config, denoiser=replace(denoiser, positions="default")),
        "regular guidance": replace(config, guidance="regular"),
        "no guidance": replace(config, guidance="none"),
        "norms first": replace(config, denoiser=replace(denoiser, transformer=replace(layers, norm_first=True))),
        "rectified": replace(config, denoiser=replace(denoiser, transformer=replace(layers, activation="relu"))),
    }[variant]
