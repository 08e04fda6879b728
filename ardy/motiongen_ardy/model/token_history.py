"""TokenHistory: the tokens of one character's windows, by the frame at which they begin, for use as history."""

from __future__ import annotations

import torch
from torch import Tensor


class TokenHistory:
    """Tokens (5P + L) of decided frames, in the world frame. Windows may begin at any frame, so token grids vary."""

    def __init__(self, patch: int) -> None:
        """patch: frames per token."""
        self._patch = patch
        self._by_frame: dict[int, Tensor] = {}

    def replace_from(self, frame: int, tokens: Tensor) -> None:
        """Store a window's tokens (N, 5P + L), the first of which begins at `frame`, replacing all from there on."""
        kept = {first: token for first, token in self._by_frame.items() if first + self._patch <= frame}
        self._by_frame = kept | {frame + self._patch * number: token for number, token in enumerate(tokens)}

    def before(self, frame: int, num_frames: int) -> Tensor | None:
        """The tokens (num_frames / P, 5P + L) of the frames before `frame`; None if whole tokens do not cover them."""
        tokens = [self._by_frame.get(first) for first in range(frame - num_frames, frame, self._patch)]
        whole = [token for token in tokens if token is not None]
        return torch.stack(whole) if whole and len(whole) == len(tokens) else None
