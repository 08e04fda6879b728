"""Window: history, horizon and future of all rows in one value, with the masks that follow from their lengths."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from motiongen_ardy.model.config import RELEASED_PATCH
from motiongen_ardy.model.sampling.projection import RootProjection


class WindowError(ValueError):
    """Raised for lengths, steps or shapes that no window can have; the message says which are allowed."""


class KeptRoots(NamedTuple):
    """Clean roots predicted in an earlier step. root: (B, N, 5P) tokens; rows: (B) bool, the rows that keep theirs."""

    root: Tensor
    rows: Tensor

    def over(self, predicted: Tensor) -> Tensor:
        """Predicted root tokens (B, N, 5P), replaced by the kept ones in the rows that keep them."""
        return torch.where(self.rows[:, None, None], self.root, predicted)


@dataclass(frozen=True)
class Window:
    """What the denoiser sees of B rows at once; rows may differ in all lengths.

    history_len, generation_len: (B) int64, frames, multiples of the patch. Frames beyond both are future, known only by
    their constraints. Row i occupies frames 0 .. num_frames-1; frame 0 is its first history frame.
    text: (B, n, W); an all-zero row stands for no text. text_mask: (B, n) bool, which text vectors count; None: all.
    heading: (B) radians, of the first frame.
    observed, mask: (B, T, D), constraints as normalised features, and where they apply (0 or 1); both are zero in the
    history. None: no constraints in any row.
    projection: what the root is projected onto between the stages; None: nothing. patch: frames per token.
    kept: roots that a two-stage denoiser uses instead of predicting them; None: none.
    """

    history_len: Tensor
    generation_len: Tensor
    num_frames: int
    text: Tensor
    heading: Tensor
    observed: Tensor | None = None
    mask: Tensor | None = None
    text_mask: Tensor | None = None
    projection: RootProjection | None = None
    patch: int = RELEASED_PATCH
    kept: KeptRoots | None = None

    def __post_init__(self) -> None:
        if self.num_frames < self.patch or self.num_frames % self.patch:
            raise WindowError(f"a window has {self.num_frames} frames; give a positive multiple of {self.patch}")
        if (self.observed is None) != (self.mask is None):
            raise WindowError("a window's observed features and their mask go together; one of them is missing")

    @property
    def num_tokens(self) -> int:
        return self.num_frames // self.patch

    @cached_property
    def _frames(self) -> Tensor:
        return torch.arange(self.num_frames, device=self.history_len.device)[None]

    @cached_property
    def history_frames(self) -> Tensor:
        """(B, T) bool: frame < history_len."""
        return self._frames < self.history_len[:, None]

    @cached_property
    def generation_frames(self) -> Tensor:
        """(B, T) bool: the horizon."""
        end = (self.history_len + self.generation_len)[:, None]
        return ~self.history_frames & (self._frames < end)

    @cached_property
    def future_frames(self) -> Tensor:
        """(B, T) bool: after the horizon."""
        return self._frames >= (self.history_len + self.generation_len)[:, None]

    @cached_property
    def history_tokens(self) -> Tensor:
        """(B, N) bool: tokens whose frames are all history."""
        return self.history_frames.unflatten(-1, (-1, self.patch)).all(-1)

    @cached_property
    def generation_tokens(self) -> Tensor:
        """(B, N) bool: tokens whose frames are all to be generated."""
        return self.generation_frames.unflatten(-1, (-1, self.patch)).all(-1)

    @cached_property
    def future_tokens(self) -> Tensor:
        """(B, N) bool: future tokens with at least one constrained feature; the others are hidden."""
        future = self.future_frames.unflatten(-1, (-1, self.patch)).all(-1)
        if self.mask is None:
            return torch.zeros_like(future)
        return future & (self.mask != 0).any(-1).unflatten(-1, (-1, self.patch)).any(-1)

    @cached_property
    def token_positions(self) -> Tensor:
        """(B, N) int64: 0 at a row's first generated token, negative in its history."""
        tokens = torch.arange(self.num_tokens, device=self.history_len.device)[None]
        return tokens - (self.history_len // self.patch)[:, None]

    def without_text(self) -> Window:
        """The same window without text."""
        return replace(self, text=torch.zeros_like(self.text))

    def without_constraints(self) -> Window:
        """The same window without constraints, so that no future token is visible."""
        return replace(self, observed=None, mask=None)
