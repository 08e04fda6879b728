"""No tokenizer: a token's latent is simply the body of its frames (the paper's explicit-representation ablation)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.tokenizer.model import by_token, root_from_tokens, valid_tokens


class ExplicitBody(nn.Module):
    """Takes the place of a `Tokenizer`; latents are normalised body features, P (D - 5) numbers for P frames."""

    def __init__(self, representation: Representation, patch: int) -> None:
        """patch: frames per token."""
        super().__init__()
        self.representation = representation
        self.patch = patch

    @property
    def latent_dim(self) -> int:
        return self.patch * self.representation.body_dim

    def to_hybrid(self, features: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised features (B, PN, D) -> tokens (B, N, P D), root first; the body of invalid tokens is zero."""
        body = by_token(features[..., ROOT_WIDTH:], self.patch)
        keep = valid_tokens(valid_frames, self.patch)
        body = body if keep is None else body * keep[..., None]
        return torch.cat([by_token(features[..., :ROOT_WIDTH], self.patch), body], dim=-1)

    def from_hybrid(self, tokens: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Tokens (B, N, P D) -> normalised features (B, PN, D)."""
        root = root_from_tokens(tokens, self.patch)
        latents = tokens[..., ROOT_WIDTH * self.patch :]
        return torch.cat([root, self.decode(latents, root, lengths, valid_frames)], dim=-1)

    def decode(self, latents: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised body (B, PN, D-5) of latents (B, N, P (D-5)); independent of the root."""
        return latents.unflatten(-1, (self.patch, -1)).flatten(1, 2)

    def decode_codes(
        self, codes: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """As `decode`, and the local root (B, PN, 4) of the given root."""
        return self.decode(codes, root, lengths, valid_frames), self.representation.local_root(root, lengths)

    def denormalize_latents(self, latents: Tensor) -> Tensor:
        """Returns them unchanged: what the denoiser predicts is what is decoded."""
        return latents

    def requantize(self, latents: Tensor) -> Tensor:
        """Returns them unchanged: there is no quantisation grid."""
        return latents
