"""Tokenizer: explicit features <-> hybrid tokens (the root of P frames, then the body's latent)."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.config import TokenizerConfig
from motiongen_ardy.model.tokenizer.decoder import Decoder
from motiongen_ardy.model.tokenizer.encoder import Encoder
from motiongen_ardy.model.tokenizer.quantizer import Quantizer


class Posterior(NamedTuple):
    """The distribution that a VAE's encoder predicts for latents: mean and log variance, each (B, N, L)."""

    mean: Tensor
    log_variance: Tensor


def valid_tokens(valid_frames: Tensor | None, patch: int) -> Tensor | None:
    """(B, PN) bool -> (B, N) bool: a token is valid if all its frames are."""
    return None if valid_frames is None else valid_frames.unflatten(-1, (-1, patch)).all(-1)


def by_token(frames: Tensor, patch: int) -> Tensor:
    """(B, PN, C) -> (B, N, PC), frame-major."""
    return frames.unflatten(1, (-1, patch)).flatten(-2)


def root_from_tokens(tokens: Tensor, patch: int) -> Tensor:
    """(B, N, 5P or more, the root first) -> (B, PN, 5)."""
    return tokens[..., : ROOT_WIDTH * patch].unflatten(-1, (patch, ROOT_WIDTH)).flatten(1, 2)


class Tokenizer(nn.Module):
    """Encoder, quantiser and decoder of the body, with the statistics of the latents.

    post_stats: of the quantised latents; pre_stats: of the encoder's raw output (used only by configurations that do
    not quantise on encoding).
    """

    def __init__(
        self, config: TokenizerConfig, representation: Representation, post_stats: Stats, pre_stats: Stats
    ) -> None:
        super().__init__()
        self.config = config
        self.representation = representation
        self.encoder = Encoder(config, representation.body_dim)
        self.decoder = Decoder(config, representation.body_dim)
        self.quantizer = Quantizer(config.levels)
        self.post_stats = post_stats
        self.pre_stats = pre_stats

    @property
    def patch(self) -> int:
        """Frames per token."""
        return self.config.patch

    @property
    def quantizes_on_encode(self) -> bool:
        return self.config.kind == "fsq" and self.config.quantize_on_encode

    @property
    def latent_stats(self) -> Stats:
        """The statistics by which latents in hybrid tokens are normalised."""
        return self.post_stats if self.quantizes_on_encode else self.pre_stats

    def normalize_latents(self, latents: Tensor) -> Tensor:
        return self.latent_stats.normalize(latents) if self.config.normalize_latents else latents

    def denormalize_latents(self, latents: Tensor) -> Tensor:
        return self.latent_stats.denormalize(latents) if self.config.normalize_latents else latents

    def posterior(self, body: Tensor, valid_frames: Tensor | None = None) -> Posterior:
        """Mean and log variance of a VAE's latents for a normalised body (B, PN, D-5)."""
        mean, log_variance = self.encoder(body, valid_tokens(valid_frames, self.patch)).chunk(2, dim=-1)
        return Posterior(mean, log_variance)

    def raw_latents(self, body: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """The encoder's output (B, N, L) for a normalised body (B, PN, D-5); for a VAE, the mean."""
        if self.config.kind == "vae":
            return self.posterior(body, valid_frames).mean
        output: Tensor = self.encoder(body, valid_tokens(valid_frames, self.patch))
        return output

    def encode(self, features: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised latents (B, N, L) of normalised features (B, PN, D); valid_frames: (B, PN) bool; None: all valid.

        The latents of invalid tokens are zero.
        """
        latents = self.raw_latents(features[..., ROOT_WIDTH:], valid_frames)
        if self.quantizes_on_encode:
            latents = self.quantizer.quantize(latents)
        latents = self.normalize_latents(latents)
        keep = valid_tokens(valid_frames, self.patch)
        return latents if keep is None else latents * keep[..., None]

    def codes(self, latents: Tensor) -> Tensor:
        """Normalised latents (B, N, L) -> the decoder's input: on the quantisation grid for FSQ, else unchanged."""
        values = self.denormalize_latents(latents)
        if self.config.kind != "fsq":
            return values
        return self.quantizer.round(values) if self.config.quantize_on_encode else self.quantizer.quantize(values)

    def requantize(self, latents: Tensor) -> Tensor:
        """Round normalised latents (B, N, L) to the quantisation grid; unchanged if encoding does not quantise."""
        if not self.quantizes_on_encode:
            return latents
        return self.normalize_latents(self.codes(latents))

    def decode(self, latents: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised body (B, PN, D-5) of normalised latents (B, N, L).

        root: normalised global root (B, PN, 5); lengths: (B) valid frames, for the root's velocities;
        valid_frames: (B, PN) bool hides padding from attention.
        """
        return self.decode_codes(self.codes(latents), root, lengths, valid_frames)[0]

    def decode_codes(
        self, codes: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """As `decode`, from codes; also returns the local root that the decoder reconstructs (B, PN, 4)."""
        condition = root if self.config.global_root else self.representation.local_root(root, lengths)
        body, local_root = self.decoder(codes, condition, valid_tokens(valid_frames, self.patch))
        return body, local_root

    def to_hybrid(self, features: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised features (B, PN, D) -> hybrid tokens (B, N, 5P + L): root first, then the latent."""
        root = by_token(features[..., :ROOT_WIDTH], self.patch)
        return torch.cat([root, self.encode(features, valid_frames)], dim=-1)

    def from_hybrid(self, tokens: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Hybrid tokens (B, N, 5P + L) -> normalised features (B, PN, D)."""
        root = root_from_tokens(tokens, self.patch)
        body = self.decode(tokens[..., ROOT_WIDTH * self.patch :], root, lengths, valid_frames)
        return torch.cat([root, body], dim=-1)


def build_tokenizer(config: TokenizerConfig, representation: Representation) -> Tokenizer:
    """A tokenizer with fresh weights, whose latents are not normalised (mean 0, std 1)."""

    def identity() -> Stats:
        return Stats(torch.zeros(config.latent_dim, device="cpu"), torch.ones(config.latent_dim, device="cpu"))

    return Tokenizer(config, representation, identity(), identity())
