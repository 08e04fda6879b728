"""The denoiser: noisy hybrid tokens -> clean ones, in two stages, root before body."""

from motiongen_ardy.config import DenoiserConfig
from motiongen_ardy.denoiser.base import Denoiser
from motiongen_ardy.denoiser.one_stage import OneStageDenoiser
from motiongen_ardy.denoiser.two_stage import TwoStageDenoiser
from motiongen_ardy.representation import Representation

__all__ = ["Denoiser", "OneStageDenoiser", "TwoStageDenoiser", "build_denoiser"]


def build_denoiser(config: DenoiserConfig, representation: Representation) -> Denoiser:
    """A denoiser with fresh weights: two stages, or one for the ablation."""
    return (TwoStageDenoiser if config.num_stages == 2 else OneStageDenoiser)(config, representation)
