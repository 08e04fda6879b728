"""The denoiser: noisy hybrid tokens -> clean ones, in two stages, root before body."""

from ardy.denoiser.two_stage import Denoiser, build_denoiser

__all__ = ["Denoiser", "build_denoiser"]
