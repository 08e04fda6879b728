"""The decoder: latents and the root -> normalised body features, causal in time."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH, ROOT_WIDTH
from motiongen_ardy.model.config import TokenizerConfig
from motiongen_ardy.model.precision import InWeightPrecision, in_weight_precision
from motiongen_ardy.model.tokenizer.encoder import MAX_TOKENS, token_visibility
from motiongen_ardy.model.transformer import PositionTable, TransformerStack


class Decoder(InWeightPrecision):
    """Latents and the root condition -> transformer -> frames of body features.

    `target_cond_blocks` is not used in decoding; it exists because released checkpoints contain its tensors.
    """

    def __init__(self, config: TokenizerConfig, body_dim: int) -> None:
        super().__init__()
        width = config.transformer.width
        condition_width = ROOT_WIDTH if config.global_root else LOCAL_ROOT_WIDTH
        self.causal = config.causal_decoder
        self.patch = config.patch
        self.input_proj = nn.Linear(config.latent_dim, width)
        self.external_cond_blocks = nn.ModuleList([nn.Linear(width + config.patch * condition_width, width)])
        self.target_cond_blocks = nn.ModuleList([nn.Linear(body_dim, width // 4)])
        self.positions = PositionTable(width, 0, MAX_TOKENS - 1)
        self.seqTransEncoder = TransformerStack(config.transformer)
        self.output_proj = nn.Linear(width, config.patch * (body_dim + LOCAL_ROOT_WIDTH))

    @in_weight_precision
    def forward(self, codes: Tensor, root: Tensor, valid_tokens: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Decode codes (B, N, L), not normalised, with the normalised root condition (B, PN, 4 or 5).

        Returns the normalised body (B, PN, D-5) and the local root that the decoder reconstructs (B, PN, 4), which only
        training uses.
        """
        condition = root.unflatten(1, (-1, self.patch)).flatten(-2)
        tokens = torch.cat([self.input_proj(codes), condition], dim=-1)
        tokens = functional.relu(self.external_cond_blocks[0](tokens))
        tokens = tokens + self.positions(torch.arange(tokens.shape[1], device=tokens.device))
        visible = token_visibility(tokens.shape[1], self.causal, valid_tokens, tokens.device)
        frames = self.output_proj(self.seqTransEncoder(tokens, visible)).unflatten(-1, (self.patch, -1))
        frames = frames.flatten(1, 2)
        return frames[..., LOCAL_ROOT_WIDTH:], frames[..., :LOCAL_ROOT_WIDTH]
