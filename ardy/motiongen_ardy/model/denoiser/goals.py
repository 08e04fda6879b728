"""A window's constraints as the denoiser reads them: by token, beside the tokens."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.tokenizer.model import by_token
from motiongen_ardy.model.window import Window


class Goals(NamedTuple):
    """Observed root and body and the whole mask, frame-major: (B, N, 5P), (B, N, 5P), (B, N, P(D-5)), (B, N, PD)."""

    observed_root: Tensor
    root_mask: Tensor
    observed_body: Tensor
    mask: Tensor

    def overwrite(self, root: Tensor) -> Tensor:
        """Root tokens (B, N, 5P) with the observed numbers where the root is constrained."""
        return root * (1 - self.root_mask) + self.observed_root * self.root_mask


def goals_of(window: Window) -> Goals | None:
    """The window's constraints by token, None when it has none."""
    if window.mask is None or window.observed is None:
        return None
    patch = window.patch
    return Goals(
        observed_root=by_token(window.observed[..., :ROOT_WIDTH], patch),
        root_mask=by_token(window.mask[..., :ROOT_WIDTH], patch),
        observed_body=by_token(window.observed[..., ROOT_WIDTH:], patch),
        mask=by_token(window.mask, patch),
    )
