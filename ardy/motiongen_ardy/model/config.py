"""Frozen configurations of every part of a model, validated on construction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from motiongen_ardy.core.problems import Problems
from motiongen_ardy.core.representation import ROOT_WIDTH

RELEASED_PATCH = 4
"""Frames per token of the released models, and of ours by default."""
MAX_PATCH = 10
MAX_TOKENS = 512
"""The most tokens of a window: there are only so many positions."""

GuidanceMode = Literal["none", "regular", "separated"]
TokenizerKind = Literal["fsq", "ae", "vae"]
PositionMode = Literal["learned_prefix_zero_at_first_generation", "default"]


class ConfigError(Problems):
    """Raised for a configuration that cannot be built; each problem names the key, the value and what is allowed."""


def require_positive(owner: str, **values: int) -> None:
    """Raise ConfigError for the first of `values` that is not a positive whole number."""
    for key, value in values.items():
        if value < 1:
            raise ConfigError(f"{owner}.{key} is {value}; it must be at least 1")


def require_patch(owner: str, patch: int) -> None:
    """Raise ConfigError unless a token can have that many frames."""
    if not 1 <= patch <= MAX_PATCH:
        raise ConfigError(f"{owner}.patch is {patch}; a token has 1 to {MAX_PATCH} frames")


def require_one_of(owner: str, key: str, value: str, allowed: tuple[str, ...]) -> None:
    """Raise ConfigError unless `value` is one of `allowed`."""
    if value not in allowed:
        raise ConfigError(f"{owner}.{key} is {value!r}; it must be one of {', '.join(allowed)}")


@dataclass(frozen=True)
class TransformerConfig:
    """One transformer: its width, feed-forward width, depth and heads."""

    width: int
    feed_forward: int
    num_layers: int
    num_heads: int
    activation: str = "gelu"
    norm_first: bool = False
    dropout: float = 0.0

    def __post_init__(self) -> None:
        require_positive("transformer", width=self.width, feed_forward=self.feed_forward, num_layers=self.num_layers)
        require_positive("transformer", num_heads=self.num_heads)
        require_one_of("transformer", "activation", self.activation, ("gelu", "relu"))
        if self.width % self.num_heads or self.width % 2:
            raise ConfigError(
                f"transformer.width is {self.width}; it must be even and a multiple of num_heads ({self.num_heads})"
            )


@dataclass(frozen=True)
class TokenizerConfig:
    """The tokenizer: body features of `patch` frames <-> one latent of `latent_dim` numbers.

    kind: "fsq" (quantised, as released), "ae" or "vae" (continuous, the paper's variants).
    levels: quantisation levels of each latent dimension.
    global_root: decode with the global root instead of the local one (the paper's ablation).
    """

    transformer: TransformerConfig
    latent_dim: int
    levels: tuple[int, ...]
    kind: TokenizerKind = "fsq"
    normalize_latents: bool = True
    quantize_on_encode: bool = True
    causal_encoder: bool = True
    causal_decoder: bool = True
    global_root: bool = False
    patch: int = RELEASED_PATCH

    def __post_init__(self) -> None:
        require_positive("tokenizer", latent_dim=self.latent_dim)
        require_patch("tokenizer", self.patch)
        require_one_of("tokenizer", "kind", self.kind, ("fsq", "ae", "vae"))
        if len(self.levels) != self.latent_dim:
            raise ConfigError(f"tokenizer.levels has {len(self.levels)} entries; latent_dim is {self.latent_dim}")
        if min(self.levels) < 2:
            raise ConfigError(f"tokenizer.levels has {min(self.levels)}; every dimension needs at least 2 levels")


@dataclass(frozen=True)
class DenoiserConfig:
    """The denoiser: two transformers of the same shape (root stage, body stage) or, for the ablation, one.

    text_tokens, text_dim: number and width of the text vectors that condition a window.
    constraints: False builds a model without constraint inputs (`motion_mask_mode: null`).
    """

    transformer: TransformerConfig
    latent_dim: int
    text_tokens: int
    text_dim: int
    use_text_mask: bool = False
    heading_token: bool = True
    constraints: bool = True
    positions: PositionMode = "learned_prefix_zero_at_first_generation"
    num_stages: Literal[1, 2] = 2
    patch: int = RELEASED_PATCH

    def __post_init__(self) -> None:
        require_positive("denoiser", latent_dim=self.latent_dim, text_tokens=self.text_tokens, text_dim=self.text_dim)
        require_one_of("denoiser", "positions", self.positions, ("learned_prefix_zero_at_first_generation", "default"))
        require_patch("denoiser", self.patch)
        if self.num_stages not in (1, 2):
            raise ConfigError(f"denoiser.num_stages is {self.num_stages}; it must be 1 or 2")

    @property
    def root_token_width(self) -> int:
        """Numbers in a token that describe the root: ROOT_WIDTH per frame."""
        return ROOT_WIDTH * self.patch


@dataclass(frozen=True)
class ModelConfig:
    """A whole model: skeleton, frame rate, horizon, guidance, and the configurations of its parts.

    tokenizer is None for the explicit-representation ablation, whose denoiser works on body features directly.
    """

    skeleton: str
    fps: int
    horizon: int
    denoiser: DenoiserConfig
    tokenizer: TokenizerConfig | None
    num_base_steps: int = 10
    guidance: GuidanceMode = "separated"

    def __post_init__(self) -> None:
        require_positive("model", fps=self.fps, horizon=self.horizon, num_base_steps=self.num_base_steps)
        require_one_of("model", "guidance", self.guidance, ("none", "regular", "separated"))
        if self.horizon % self.patch:
            raise ConfigError(f"model.horizon is {self.horizon}; it must be a multiple of {self.patch} frames, a token")
        if self.tokenizer is not None and self.tokenizer.patch != self.patch:
            raise ConfigError(f"denoiser.patch is {self.patch} but the tokenizer's is {self.tokenizer.patch}")
        if self.tokenizer is not None and self.tokenizer.latent_dim != self.denoiser.latent_dim:
            raise ConfigError(
                f"denoiser.latent_dim is {self.denoiser.latent_dim} but the tokenizer's is {self.tokenizer.latent_dim}"
            )

    @property
    def patch(self) -> int:
        """Frames per token."""
        return self.denoiser.patch

    @property
    def horizon_tokens(self) -> int:
        return self.horizon // self.patch

    @property
    def token_width(self) -> int:
        """Numbers in a hybrid token: the root of its frames, then the latent."""
        return self.denoiser.root_token_width + self.denoiser.latent_dim

    @property
    def max_window_frames(self) -> int:
        """The longest window (history, horizon and future): 10 s of frames in whole tokens, limited by the positions
        that the prefix of text, step and heading leaves free.
        """
        most = max(0, MAX_TOKENS - self.denoiser.text_tokens - 2)
        return min(10 * self.fps // self.patch, most) * self.patch
