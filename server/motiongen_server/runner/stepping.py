"""Stepping: a denoising step of prepared rows, however much they differ."""

from __future__ import annotations

from operator import is_
from typing import NamedTuple

import torch
from torch import Tensor

from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedBatch, PackedDenoiser
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.graphs import GraphedRows, RowWork, keeping
from motiongen_server.runner.row import Row


class _Last(NamedTuple):
    """The rows of a step, their layout, and their tokens after it."""

    rows: tuple[Row, ...]
    batch: PackedBatch
    tokens: Tensor


class Stepping:
    """Steps of one model's rows. graphs: the cache from which the work on a prediction is replayed."""

    def __init__(self, model: Model, denoiser: PackedDenoiser, graphs: GraphCache | None = None) -> None:
        device = model.representation.stats.mean.device
        self._denoiser = denoiser
        self._device = device
        self._options = model.sampling.projection
        self._root_width = model.config.denoiser.root_token_width
        schedule = cosine_schedule(model.config.num_base_steps)
        self._base_steps: list[list[int]] = schedule.base_step.tolist()
        self._schedule = schedule.to(device)
        self._move: RowWork = self._moved if graphs is None else keeping(GraphedRows(self._moved, graphs))
        self._last: _Last | None = None

    def __call__(self, rows: dict[int, Row]) -> list[bool]:
        """Advance the rows, by job, by one step. Returns whether the tokens of each are finite."""
        batch, tokens = self._laid_out(rows)
        of_rows = [(row.job.num_steps, row.job.num_steps - 1 - row.steps_done) for row in rows.values()]
        numbers = [(self._base_steps[num_steps][index], index, num_steps) for num_steps, index in of_rows]
        steps = torch.tensor(numbers).to(self._device)  # all in one copy to the device
        options = self._options
        project = [index < options.last_steps for _, index in of_rows]
        kept = [row.root if row.steps_done >= options.led_steps else None for row in rows.values()]
        clean = self._denoiser.predict(batch, tokens, steps[:, 0], project, kept)
        moved, finite = self._move(tokens, clean, steps)
        for row, of_row in zip(rows.values(), moved.unbind(), strict=True):
            row.tokens = of_row
            row.steps_done += 1
        for number, row in enumerate(rows.values()):
            if row.is_led:
                row.root = clean[number, :, : self._root_width]
        self._last = _Last(tuple(rows.values()), batch, moved)
        return finite.tolist()

    def forget(self) -> None:
        """Drop the last step's rows, as no rows are left."""
        self._last = None

    def _laid_out(self, rows: dict[int, Row]) -> tuple[PackedBatch, Tensor]:
        """The rows' layout and tokens; reused if the rows are those of the step before, as usual."""
        last = self._last
        if last is not None and len(last.rows) == len(rows) and all(map(is_, last.rows, rows.values())):
            return last.batch, last.tokens
        batch = self._denoiser.batch([row.conditions for row in rows.values()])
        return batch, torch.stack([row.tokens for row in rows.values()])

    def _moved(self, tokens: Tensor, clean: Tensor, steps: Tensor) -> tuple[Tensor, Tensor]:
        """Tokens (R, ...) after a step towards the clean ones, and whether those of each row are finite.

        steps: (R, 3): each row's base step, how many steps follow this one, and how many there are in total.
        """
        moved = self._schedule.reverse_step(tokens, clean, steps[:, 1], steps[:, 2])
        return moved, moved.isfinite().flatten(1).all(dim=1)
