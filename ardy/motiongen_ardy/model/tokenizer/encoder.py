"""The encoder: normalised body features -> one vector of latent_dim numbers per patch of frames."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from motiongen_ardy.model.config import TokenizerConfig
from motiongen_ardy.model.precision import InWeightPrecision, in_weight_precision
from motiongen_ardy.model.transformer import PositionTable, TransformerStack

MAX_TOKENS = 512


def token_visibility(num_tokens: int, causal: bool, valid_tokens: Tensor | None, device: torch.device) -> Tensor | None:
    """Bool mask (B or 1, 1, N, N): which keys each query sees; None if it sees all."""
    visible = None
    if causal:
        visible = torch.ones(num_tokens, num_tokens, dtype=torch.bool, device=device).tril()[None, None]
    if valid_tokens is not None:
        keys = valid_tokens[:, None, None, :]
        visible = keys if visible is None else visible & keys
    return visible


class Encoder(InWeightPrecision):
    """Patches of frames -> transformer (causal by default) -> latents; for a VAE, mean and log variance."""

    def __init__(self, config: TokenizerConfig, body_dim: int) -> None:
        super().__init__()
        width = config.transformer.width
        outputs = config.latent_dim * (2 if config.kind == "vae" else 1)
        self.causal = config.causal_encoder
        self.patch = config.patch
        self.input_proj = nn.Linear(config.patch * body_dim, width)
        self.positions = PositionTable(width, 0, MAX_TOKENS - 1)
        self.seqTransEncoder = TransformerStack(config.transformer)
        self.output_proj = nn.Linear(width, outputs)

    @in_weight_precision
    def forward(self, body: Tensor, valid_tokens: Tensor | None = None) -> Tensor:
        """body: (B, T, D-5) normalised, T a multiple of the patch P; valid_tokens: (B, T/P) bool. -> (B, T/P, L)."""
        patches = body.unflatten(1, (-1, self.patch)).flatten(-2)
        tokens = self.input_proj(patches)
        tokens = tokens + self.positions(torch.arange(tokens.shape[1], device=tokens.device))
        visible = token_visibility(tokens.shape[1], self.causal, valid_tokens, tokens.device)
        output: Tensor = self.output_proj(self.seqTransEncoder(tokens, visible))
        return output
