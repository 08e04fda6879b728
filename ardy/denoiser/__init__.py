"""The denoiser: noisy hybrid tokens -> clean ones, in two stages, root before body."""

from ardy.config import DenoiserConfig
from ardy.denoiser.base import Denoiser
from ardy.denoiser.one_stage import OneStageDenoiser
from ardy.denoiser.two_stage import TwoStageDenoiser
from ardy.representation import Representation

__all__ = ["Denoiser", "OneStageDenoiser", "TwoStageDenoiser", "build_denoiser"]


def build_denoiser(config: DenoiserConfig, representation: Representation) -> Denoiser:
    """A denoiser with fresh weights: two stages, or one for the ablation."""
    return (TwoStageDenoiser if config.num_stages == 2 else OneStageDenoiser)(config, representation)
