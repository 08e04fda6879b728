"""No tokenizer: a token's latent is the body of its frames as it is (the paper's explicit-representation ablation)."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.core.representation import ROOT_WIDTH, Representation
from motiongen_ardy.model.config import FRAMES_PER_TOKEN
from motiongen_ardy.model.tokenizer.model import ROOT_TOKEN_WIDTH, root_from_tokens, root_to_tokens, valid_tokens


class ExplicitBody(nn.Module):
    """Stands where a `Tokenizer` does; latents are normalised body features, frame-major, 4 (D - 5) numbers."""

    def __init__(self, representation: Representation) -> None:
        super().__init__()
        self.representation = representation

    @property
    def latent_dim(self) -> int:
        return FRAMES_PER_TOKEN * self.representation.body_dim

    def to_hybrid(self, features: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised features (B, 4N, D) -> tokens (B, N, 4 D): root first; the body of tokens not valid is zero."""
        body = features[..., ROOT_WIDTH:].unflatten(1, (-1, FRAMES_PER_TOKEN)).flatten(-2)
        keep = valid_tokens(valid_frames)
        body = body if keep is None else body * keep[..., None]
        return torch.cat([root_to_tokens(features[..., :ROOT_WIDTH]), body], dim=-1)

    def from_hybrid(self, tokens: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Tokens (B, N, 4 D) -> normalised features (B, 4N, D)."""
        root = root_from_tokens(tokens)
        return torch.cat([root, self.decode(tokens[..., ROOT_TOKEN_WIDTH:], root, lengths, valid_frames)], dim=-1)

    def decode(self, latents: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None) -> Tensor:
        """Normalised body (B, 4N, D-5) of latents (B, N, 4 (D-5)); the root has no say in it."""
        return latents.unflatten(-1, (FRAMES_PER_TOKEN, -1)).flatten(1, 2)

    def decode_codes(
        self, codes: Tensor, root: Tensor, lengths: Tensor, valid_frames: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """As `decode`, and the local root (B, 4N, 4) of the given root."""
        return self.decode(codes, root, lengths, valid_frames), self.representation.local_root(root, lengths)

    def denormalize_latents(self, latents: Tensor) -> Tensor:
        """Unchanged: what the denoiser predicts is what is decoded."""
        return latents

    def requantize(self, latents: Tensor) -> Tensor:
        """Unchanged: there is no grid."""
        return latents
