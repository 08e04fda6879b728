"""Classifier-free guidance: which passes a row needs, and their weighted sum.

With u the unconditioned pass: separated: u + w_t (text - u) + w_c (constraints - u); joint: both + (w_t - 1) (text - u)
+ (w_c - 1) (constraints - u), a single pass if both weights are 1; regular: u + w_t (both - u); none: both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import torch
from torch import Tensor

from motiongen_ardy.model.denoiser.base import Denoiser
from motiongen_ardy.model.sampling.options import PassMode
from motiongen_ardy.model.window import KeptRoots, Window


@dataclass(frozen=True)
class GuidanceWeights:
    """The two weights of one row; the constraint weight is used in separated and joint guidance only."""

    text: float = 2.0
    constraint: float = 2.0

    def __post_init__(self) -> None:
        for name, weight in (("text", self.text), ("constraint", self.constraint)):
            if not math.isfinite(weight):
                raise ValueError(f"the {name} guidance weight is {weight}; it must be a finite number")


class Pass(NamedTuple):
    """One evaluation of the denoiser for a row: its conditions, and its weight in the guided prediction."""

    with_text: bool
    with_constraints: bool
    weight: float


def full_passes(mode: PassMode, weights: GuidanceWeights) -> tuple[Pass, ...]:
    """All passes of the mode's formula, whether needed or not."""
    if mode == "none":
        return (Pass(True, True, 1.0),)
    if mode == "regular":
        return (Pass(True, True, weights.text), Pass(False, False, 1.0 - weights.text))
    if mode == "joint":
        return (
            Pass(True, True, 1.0),
            Pass(True, False, weights.text - 1.0),
            Pass(False, True, weights.constraint - 1.0),
            Pass(False, False, 2.0 - weights.text - weights.constraint),
        )
    return (
        Pass(True, False, weights.text),
        Pass(False, True, weights.constraint),
        Pass(False, False, 1.0 - weights.text - weights.constraint),
    )


@lru_cache(maxsize=1024)
def needed_passes(mode: PassMode, weights: GuidanceWeights, has_text: bool, has_constraints: bool) -> tuple[Pass, ...]:
    """The same weighted sum with as few passes as possible.

    Without text or constraints some passes are identical, and a pass with weight 0 is dropped.
    """
    merged: dict[tuple[bool, bool], float] = {}
    for with_text, with_constraints, weight in full_passes(mode, weights):
        key = (with_text and has_text, with_constraints and has_constraints)
        merged[key] = merged.get(key, 0.0) + weight
    kept = [(key, weight) for key, weight in merged.items() if weight != 0.0]
    if len(kept) <= 1:  # the weights sum to 1, but their sum need not be 1 after rounding
        told = kept[0][0] if kept else (False, False)
        return (Pass(*told, 1.0),)
    return tuple(Pass(*told, weight) for told, weight in kept)


class PassBatch(NamedTuple):
    """The passes of all rows, flattened: row, text flag, constraint flag and weight of each, all (R)."""

    rows: Tensor
    with_text: Tensor
    with_constraints: Tensor
    weight: Tensor


def batch_passes(passes: list[tuple[Pass, ...]], device: torch.device | str = "cpu") -> PassBatch:
    """Flatten the passes of rows 0, 1, ..."""
    flat = [(row, one) for row, group in enumerate(passes) for one in group]

    def column(values: list[float]) -> Tensor:
        return torch.tensor(values, dtype=torch.float32, device=device)

    return PassBatch(
        torch.tensor([row for row, _ in flat], device=device),
        column([float(one.with_text) for _, one in flat]),
        column([float(one.with_constraints) for _, one in flat]),
        column([one.weight for _, one in flat]),
    )


def expand_window(window: Window, batch: PassBatch) -> Window:
    """The window repeated for every pass, without text or constraints where the pass has none."""
    rows = batch.rows
    observed, mask = window.observed, window.mask
    if observed is not None and mask is not None:
        told = batch.with_constraints[:, None, None]
        observed, mask = observed[rows] * told, mask[rows] * told
    return replace(
        window,
        history_len=window.history_len[rows],
        generation_len=window.generation_len[rows],
        text=window.text[rows] * batch.with_text[:, None, None],
        heading=window.heading[rows],
        observed=observed,
        mask=mask,
        text_mask=None if window.text_mask is None else window.text_mask[rows],
        projection=None if window.projection is None else window.projection.rows(rows),
        kept=None if window.kept is None else KeptRoots(window.kept.root[rows], window.kept.rows[rows]),
    )


def guided_prediction(denoiser: Denoiser, tokens: Tensor, step: Tensor, window: Window, batch: PassBatch) -> Tensor:
    """The guided clean tokens (B, N, 5P + L); tokens and step as in `Denoiser.forward`, one row per window."""
    predictions = denoiser(tokens[batch.rows], step[batch.rows], expand_window(window, batch))
    weighted = predictions.to(tokens.dtype) * batch.weight[:, None, None]
    return torch.zeros_like(tokens).index_add_(0, batch.rows, weighted)
