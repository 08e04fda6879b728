"""The transformer of tokenizer and denoiser: post-norm layers with packed attention, and sinusoidal positions.

Parameter names are those of the released checkpoints (`self_attn.in_proj_weight`, `linear1.weight`, ...).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.model.config import TransformerConfig


class SelfAttention(nn.Module):
    """Multi-head self-attention; one packed projection gives q, k and v, whose heads are contiguous slices."""

    def __init__(self, width: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.in_proj_weight = nn.Parameter(torch.empty(3 * width, width))
        self.in_proj_bias = nn.Parameter(torch.zeros(3 * width))
        self.out_proj = nn.Linear(width, width)
        nn.init.xavier_uniform_(self.in_proj_weight)
        nn.init.zeros_(self.out_proj.bias)

    def projected(self, tokens: Tensor) -> Tensor:
        """Queries, keys and values (B, N, 3 width) of tokens (B, N, width)."""
        return functional.linear(tokens, self.in_proj_weight, self.in_proj_bias)

    def forward(self, tokens: Tensor, visible: Tensor | None) -> Tensor:
        """tokens: (B, N, width); visible: bool, as (B, heads, N, N), true where a query sees a key; None: all."""
        packed = self.projected(tokens)
        query, key, value = packed.unflatten(-1, (3, self.num_heads, -1)).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(query, key, value, attn_mask=visible)
        output: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(-2))
        return output


class TransformerLayer(nn.Module):
    """x <- LN(x + attention(x)); x <- LN(x + W2 gelu(W1 x)); with `norm_first`, the norms come before instead."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.self_attn = SelfAttention(config.width, config.num_heads)
        self.linear1 = nn.Linear(config.width, config.feed_forward)
        self.linear2 = nn.Linear(config.feed_forward, config.width)
        self.norm1 = nn.LayerNorm(config.width)
        self.norm2 = nn.LayerNorm(config.width)
        self.norm_first = config.norm_first
        self.dropout = nn.Dropout(config.dropout)
        self.activation = functional.gelu if config.activation == "gelu" else functional.relu

    def _feed_forward(self, tokens: Tensor) -> Tensor:
        output: Tensor = self.linear2(self.dropout(self.activation(self.linear1(tokens))))
        return output

    def forward(self, tokens: Tensor, visible: Tensor | None) -> Tensor:
        if self.norm_first:
            tokens = tokens + self.dropout(self.self_attn(self.norm1(tokens), visible))
            return tokens + self.dropout(self._feed_forward(self.norm2(tokens)))
        tokens = self.norm1(tokens + self.dropout(self.self_attn(tokens, visible)))
        output: Tensor = self.norm2(tokens + self.dropout(self._feed_forward(tokens)))
        return output


class TransformerStack(nn.Module):
    """Layers in sequence, without a final norm."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(TransformerLayer(config) for _ in range(config.num_layers))

    def forward(self, tokens: Tensor, visible: Tensor | None = None) -> Tensor:
        """tokens: (B, N, width); visible: as in `SelfAttention.forward`."""
        for layer in self.layers:
            tokens = layer(tokens, visible)
        return tokens


def sinusoid_rows(positions: Tensor, width: int) -> Tensor:
    """Sinusoidal embedding (..., width) of positions (...): sin and cos interleaved, w_k = 10000^(-2k/width).

    Everything is evaluated in float32 on purpose: the released models were trained with this rounding.
    """
    exponents = -torch.arange(0, width, 2, device=positions.device).float() / width
    frequencies = torch.pow(torch.tensor(10000.0, device=positions.device), exponents)
    angles = positions.float().unsqueeze(-1) * frequencies
    return torch.stack([angles.sin(), angles.cos()], dim=-1).flatten(-2)


class PositionTable(nn.Module):
    """Sinusoidal rows for integer positions lowest..highest, looked up by index; not stored in checkpoints."""

    rows: Tensor

    def __init__(self, width: int, lowest: int, highest: int) -> None:
        super().__init__()
        self.lowest = lowest
        self.highest = highest
        positions = torch.arange(lowest, highest + 1, device="cpu")  # not loaded from a file: real even on "meta"
        self.register_buffer("rows", sinusoid_rows(positions, width), persistent=False)

    def forward(self, positions: Tensor) -> Tensor:
        """(...) integers in lowest..highest -> (..., width). On a CPU, positions outside raise IndexError."""
        return self.rows[self.checked(positions)]

    def checked(self, positions: Tensor) -> Tensor:
        """Row indices of positions; a negative index would silently wrap round to the end of the table."""
        indices = positions - self.lowest
        if not torch.compiler.is_compiling() and indices.device.type == "cpu" and bool((indices < 0).any()):
            raise IndexError(f"position {int(positions.min())} is below the table's lowest, {self.lowest}")
        return indices
