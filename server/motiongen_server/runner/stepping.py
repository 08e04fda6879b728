"""A denoising step of prepared rows, whatever they have or have not in common."""

from __future__ import annotations

from collections.abc import Sequence
from operator import is_
from typing import NamedTuple

import torch
from torch import Tensor

from motiongen_ardy.model.diffusion import cosine_schedule
from motiongen_ardy.model.model import Model
from motiongen_ardy.model.packed import PackedBatch, PackedDenoiser
from motiongen_ardy.model.packed.batch import Batch
from motiongen_ardy.model.packed.graphs import GraphedRows, GraphRecorder
from motiongen_server.runner.row import Row


class Stepped(NamedTuple):
    """Of each row, its tokens after a step, the clean root that it predicted, and whether its tokens are finite."""

    tokens: Tensor
    roots: Tensor
    finite: Tensor


class _Last(NamedTuple):
    """The rows of a step, how they are laid out, and their tokens after it."""

    rows: tuple[Row, ...]
    batch: PackedBatch
    tokens: Tensor


class Stepping:
    """Steps of one model's rows. With a recorder, a step of rows that are alike is replayed as one graph."""

    def __init__(self, model: Model, denoiser: PackedDenoiser, recorder: GraphRecorder | None = None) -> None:
        device = model.representation.stats.mean.device
        self._denoiser = denoiser
        self._device = device
        self._options = model.sampling.projection
        self._root_width = model.config.denoiser.root_token_width
        self._schedule = cosine_schedule(model.config.num_base_steps).to(device)
        self._replayed = None if recorder is None else GraphedRows(self._recorded, recorder)
        self._last: _Last | None = None

    def __call__(self, rows: dict[int, Row]) -> list[bool]:
        """Take the rows, by job, one step further. Returns whether the tokens of each are finite."""
        batch, tokens = self._laid_out(rows)
        done = [[row.job.num_steps, row.steps_done] for row in rows.values()]
        steps = torch.tensor(done).to(self._device)  # both in one copy to the device
        parts = None if self._replayed is None or batch.projection is not None else batch.parts()
        if self._replayed is None or parts is None:
            options = self._options
            project = [row.job.num_steps - row.steps_done <= options.last_steps for row in rows.values()]
            kept = [row.root if row.steps_done >= options.led_steps else None for row in rows.values()]
            stepped = self._stepped(batch, tokens, steps, project, kept)
            for row, root in zip(rows.values(), stepped.roots.unbind(), strict=True):
                row.root = root if row.is_led else None
        else:  # none of the rows is led
            stepped = self._replay(self._replayed, batch, tokens, steps, parts)
        for row, moved in zip(rows.values(), stepped.tokens.unbind(), strict=True):
            row.tokens = moved
            row.steps_done += 1
        self._last = _Last(tuple(rows.values()), batch, stepped.tokens)
        return stepped.finite.tolist()

    def forget(self) -> None:
        """There are no rows any more."""
        self._last = None

    def _laid_out(self, rows: dict[int, Row]) -> tuple[PackedBatch, Tensor]:
        """The rows laid out, and their tokens; most steps have the same rows as the step before."""
        last = self._last
        if last is not None and len(last.rows) == len(rows) and all(map(is_, last.rows, rows.values())):
            return last.batch, last.tokens
        batch = self._denoiser.batch([row.conditions for row in rows.values()])
        return batch, torch.stack([row.tokens for row in rows.values()])

    def _stepped(
        self,
        batch: Batch,
        tokens: Tensor,
        steps: Tensor,
        project: Sequence[bool] | None = None,
        kept: Sequence[Tensor | None] | None = None,
    ) -> Stepped:
        """steps: (R, 2), how many a row has, and how many are done."""
        num_steps, steps_done = steps.unbind(1)
        index = num_steps - 1 - steps_done
        clean = self._denoiser.predict(batch, tokens, self._schedule.base_step[num_steps, index], project, kept)
        moved = self._schedule.reverse_step(tokens, clean, index, num_steps)
        return Stepped(moved, clean[..., : self._root_width], moved.isfinite().flatten(1).all(dim=1))

    def _recorded(self, tokens: Tensor, steps: Tensor, *parts: Tensor) -> Stepped:
        return self._stepped(self._denoiser.recorded_batch(parts), tokens, steps)

    def _replay(
        self, replayed: GraphedRows, batch: Batch, tokens: Tensor, steps: Tensor, parts: tuple[Tensor, ...]
    ) -> Stepped:
        before = replayed.num_recorded
        moved, roots, finite = replayed(tokens, steps, *parts)
        stepped = Stepped(moved.clone(), roots, finite)  # the others are read, if at all, before the next replay
        if replayed.num_recorded > before:
            # Beside rows of another kind, rows of this one are called: their layers are to be recorded by then, too.
            self._stepped(batch, tokens, steps)
        return stepped
