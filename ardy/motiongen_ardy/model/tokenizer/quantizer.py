"""Finite scalar quantisation (Mentzer et al. 2023): the encode-side quantiser and the decode-side rounding.

They differ: encoding squashes with tanh and yields `levels` values; rounding clamps to [-1, 1] and also admits +1.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

SHRINK = 1.001  # keeps tanh's range slightly wider than the outermost levels, so that they can be reached


class Quantizer(nn.Module):
    """FSQ with a number of levels per dimension; codes lie in [-1, 1] in steps of 1/(levels // 2)."""

    half_range: Tensor
    offset: Tensor
    shift: Tensor
    half_levels: Tensor

    def __init__(self, levels: tuple[int, ...]) -> None:
        super().__init__()
        count = torch.tensor(levels, dtype=torch.float64, device="cpu")  # not loaded from a file: real even on "meta"
        half_range = (count - 1) * SHRINK / 2
        offset = torch.where(count % 2 == 0, 0.5, 0.0)
        self.register_buffer("half_range", half_range.float(), persistent=False)
        self.register_buffer("offset", offset.float(), persistent=False)
        self.register_buffer("shift", torch.atanh(offset / half_range).float(), persistent=False)
        self.register_buffer("half_levels", torch.floor(count / 2).float(), persistent=False)

    def quantize(self, latents: Tensor) -> Tensor:
        """(..., L), any numbers, -> (..., L) codes. The gradient passes straight through the rounding."""
        bounded = torch.tanh(latents + self.shift) * self.half_range - self.offset
        rounded = bounded + (torch.round(bounded) - bounded).detach()
        return rounded / self.half_levels

    def round(self, codes: Tensor) -> Tensor:
        """(..., L) approximate codes -> the nearest codes, half to even, after clamping to [-1, 1]."""
        return torch.round(codes.clamp(-1, 1) * self.half_levels) / self.half_levels
