"""TokenHistory: the tokens of one character's windows by the frame they begin at, for use as history."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.model.config import FRAMES_PER_TOKEN


class TokenHistory:
    """Tokens (20 + L) of decided frames, in the world frame. A window may begin at any frame, so grids change."""

    def __init__(self) -> None:
        self._by_frame: dict[int, Tensor] = {}

    def replace_from(self, frame: int, tokens: Tensor) -> None:
        """Take in a window's tokens (N, 20 + L), the first of which begins at `frame`, for all from there on."""
        kept = {first: token for first, token in self._by_frame.items() if first + FRAMES_PER_TOKEN <= frame}
        self._by_frame = kept | {frame + FRAMES_PER_TOKEN * number: token for number, token in enumerate(tokens)}

    def before(self, frame: int, num_frames: int) -> Tensor | None:
        """The tokens (num_frames / 4, 20 + L) of the frames up to `frame`; None where whole ones do not cover them."""
        tokens = [self._by_frame.get(first) for first in range(frame - num_frames, frame, FRAMES_PER_TOKEN)]
        whole = [token for token in tokens if token is not None]
        return torch.stack(whole) if whole and len(whole) == len(tokens) else None
