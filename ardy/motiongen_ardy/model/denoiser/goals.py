"""A window's constraints per token, as the denoiser reads them."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.tokenizer.model import by_token
from motiongen_ardy.model.window import Window


class Goals(NamedTuple):
    """Observed root (B, N, 5P) and its mask, observed body (B, N, P(D-5)), whole mask (B, N, PD); frame-major."""

    observed_root: Tensor
    root_mask: Tensor
    observed_body: Tensor
    mask: Tensor

    def overwrite(self, root: Tensor) -> Tensor:
        """Root tokens (B, N, 5P), replaced by the observed values where the root is constrained."""
        return root * (1 - self.root_mask) + self.observed_root * self.root_mask


def goals_of(window: Window) -> Goals | None:
    """The window's constraints per token; None if it has none."""
    if window.mask is None or window.observed is None:
        return None
    patch = window.patch
    return Goals(
        observed_root=by_token(window.observed[..., :ROOT_WIDTH], patch),
        root_mask=by_token(window.mask[..., :ROOT_WIDTH], patch),
        observed_body=by_token(window.observed[..., ROOT_WIDTH:], patch),
        mask=by_token(window.mask, patch),
    )
