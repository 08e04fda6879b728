"""The models released by NVIDIA: their names and configurations. Their weights are not included.

To run one, everything is read from its own folder; the configurations here serve to build models of the same size with
random weights, for measurements and tests.
"""

from __future__ import annotations

from motiongen_ardy.model.config import DenoiserConfig, ModelConfig, TokenizerConfig, TransformerConfig

RELEASED_BY = "nvidia"
NICKNAMES = {
    "core": "ARDY-Core-RP-20FPS-Horizon40",
    "core40": "ARDY-Core-RP-20FPS-Horizon40",
    "core8": "ARDY-Core-RP-20FPS-Horizon8",
    "g1": "ARDY-G1-RP-25FPS-Horizon52",
    "g152": "ARDY-G1-RP-25FPS-Horizon52",
    "g18": "ARDY-G1-RP-25FPS-Horizon8",
}


def _config(skeleton: str, fps: int, horizon: int) -> ModelConfig:
    return ModelConfig(
        skeleton=skeleton,
        fps=fps,
        horizon=horizon,
        denoiser=DenoiserConfig(TransformerConfig(1024, 2048, 8, 8), latent_dim=128, text_tokens=1, text_dim=4096),
        tokenizer=TokenizerConfig(TransformerConfig(512, 1024, 8, 4), latent_dim=128, levels=(64,) * 128),
    )


RELEASED = {
    "ARDY-Core-RP-20FPS-Horizon40": _config("core27", 20, 40),
    "ARDY-Core-RP-20FPS-Horizon8": _config("core27", 20, 8),
    "ARDY-G1-RP-25FPS-Horizon52": _config("g134", 25, 52),
    "ARDY-G1-RP-25FPS-Horizon8": _config("g134", 25, 8),
}
