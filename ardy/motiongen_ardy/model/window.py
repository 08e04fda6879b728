"""Window: history, horizon and future of every row as one value, with the masks that follow from the lengths."""

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
    """Clean roots that an earlier step has predicted. root: (B, N, 5P) tokens; rows: (B) bool, who keep theirs."""

    root: Tensor
    rows: Tensor

    def over(self, predicted: Tensor) -> Tensor:
        """Root tokens (B, N, 5P), the kept ones in place of those that were predicted."""
        return torch.where(self.rows[:, None, None], self.root, predicted)


@dataclass(frozen=True)
class Window:
    """What the denoiser sees of B rows at once; rows may differ in every length.

    history_len, generation_len: (B) int64 frames, multiples of the patch. Frames past both are future, known only by
    constraints. Row i occupies frames 0 .. num_frames-1, frame 0 being its first history frame.
    text: (B, n, W); an all-zero row stands for no text. text_mask: (B, n) bool or None, which text vectors count.
    heading: (B) radians, of the first frame.
    observed, mask: (B, T, D), constraints as normalised features and where they hold (0 or 1); both are zero in the
    history. None = no constraints in any row.
    projection: what the root is brought onto between the stages; None for nothing. patch: frames of a token.
    kept: roots that a denoiser of two stages is to take in place of its own; None for none.
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
        """(B, N) bool: tokens all of whose frames are history."""
        return self.history_frames.unflatten(-1, (-1, self.patch)).all(-1)

    @cached_property
    def generation_tokens(self) -> Tensor:
        """(B, N) bool: tokens all of whose frames are to be generated."""
        return self.generation_frames.unflatten(-1, (-1, self.patch)).all(-1)

    @cached_property
    def future_tokens(self) -> Tensor:
        """(B, N) bool: future tokens that carry at least one constrained feature; the others are hidden."""
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
        """The same window with the text taken away."""
        return replace(self, text=torch.zeros_like(self.text))

    def without_constraints(self) -> Window:
        """The same window with the constraints taken away, so that no future token is visible."""
        return replace(self, observed=None, mask=None)
