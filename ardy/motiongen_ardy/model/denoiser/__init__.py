"""The denoiser: noisy hybrid tokens -> clean ones, in two stages, root before body."""

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import DenoiserConfig
from motiongen_ardy.model.denoiser.base import Denoiser
from motiongen_ardy.model.denoiser.one_stage import OneStageDenoiser
from motiongen_ardy.model.denoiser.two_stage import TwoStageDenoiser

__all__ = ["Denoiser", "OneStageDenoiser", "TwoStageDenoiser", "build_denoiser"]


def build_denoiser(config: DenoiserConfig, representation: Representation) -> Denoiser:
    """A denoiser with fresh weights: two stages, or one for the ablation."""
    return (TwoStageDenoiser if config.num_stages == 2 else OneStageDenoiser)(config, representation)
