"""Model: skeleton, representation, tokenizer and denoiser in one module."""

from __future__ import annotations

from torch import nn

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.skeleton import Skeleton, load_skeleton
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import ConfigError, ModelConfig
from motiongen_ardy.model.denoiser import Denoiser, build_denoiser
from motiongen_ardy.model.sampling.options import SamplingOptions, released_options
from motiongen_ardy.model.sampling.paces import PromptPaces
from motiongen_ardy.model.tokenizer import ExplicitBody, Tokenizer, build_tokenizer


class Model(nn.Module):
    """Everything that turns noise, history, text and constraints into motion.

    tokenizer: None for the explicit-representation ablation. sampling: the model's own sampling options; by default
    those of the released models.
    """

    def __init__(
        self,
        config: ModelConfig,
        representation: Representation,
        denoiser: Denoiser,
        tokenizer: Tokenizer | None,
        sampling: SamplingOptions | None = None,
    ) -> None:
        super().__init__()
        self.config = config
        self.representation = representation
        self.denoiser = denoiser
        self.tokenizer = tokenizer
        self.sampling = released_options(config.guidance) if sampling is None else sampling
        self.paces: PromptPaces | None = None

    @property
    def skeleton(self) -> Skeleton:
        return self.representation.skeleton

    @property
    def codec(self) -> Tokenizer | ExplicitBody:
        """The codec between features and hybrid tokens."""
        return ExplicitBody(self.representation, self.config.patch) if self.tokenizer is None else self.tokenizer

    @property
    def num_parameters(self) -> int:
        """The number of parameters of denoiser and tokenizer together."""
        return sum(parameter.numel() for parameter in self.parameters())


def build_model(config: ModelConfig, motion_stats: Stats) -> Model:
    """A model with fresh weights. motion_stats: of width D + 4, as `stats/motion` of a checkpoint.

    Raises ConfigError if a denoiser without tokenizer is not as wide as the body features that it works on.
    """
    representation = Representation(load_skeleton(config.skeleton), config.fps, motion_stats)
    explicit_dim = ExplicitBody(representation, config.patch).latent_dim
    if config.tokenizer is None and config.denoiser.latent_dim != explicit_dim:
        raise ConfigError(
            f"denoiser.latent_dim is {config.denoiser.latent_dim}; without a tokenizer it must be {explicit_dim},"
            f" the body features of a token of {config.skeleton}"
        )
    tokenizer = None if config.tokenizer is None else build_tokenizer(config.tokenizer, representation)
    return Model(config, representation, build_denoiser(config.denoiser, representation), tokenizer)
