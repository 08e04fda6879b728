"""Model: skeleton, representation, tokenizer and denoiser as one value."""

from __future__ import annotations

from torch import nn

from ardy.config import ModelConfig
from ardy.denoiser import Denoiser, build_denoiser
from ardy.representation import Representation
from ardy.skeleton import Skeleton, load_skeleton
from ardy.stats import Stats
from ardy.tokenizer import Tokenizer, build_tokenizer


class Model(nn.Module):
    """Everything that turns noise, history, text and constraints into motion.

    tokenizer is None for the explicit-representation ablation.
    """

    def __init__(
        self, config: ModelConfig, representation: Representation, denoiser: Denoiser, tokenizer: Tokenizer | None
    ) -> None:
        super().__init__()
        self.config = config
        self.representation = representation
        self.denoiser = denoiser
        self.tokenizer = tokenizer

    @property
    def skeleton(self) -> Skeleton:
        return self.representation.skeleton

    @property
    def num_parameters(self) -> int:
        """How many numbers denoiser and tokenizer hold together."""
        return sum(parameter.numel() for parameter in self.parameters())


def build_model(config: ModelConfig, motion_stats: Stats) -> Model:
    """A model with fresh weights. motion_stats: width D + 4, as `stats/motion` of a checkpoint."""
    representation = Representation(load_skeleton(config.skeleton), config.fps, motion_stats)
    tokenizer = None if config.tokenizer is None else build_tokenizer(config.tokenizer, representation)
    return Model(config, representation, build_denoiser(config.denoiser, representation), tokenizer)
