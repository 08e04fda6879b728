"""Evaluations of the denoiser replayed as graphs: one graph covers both stages, for sequences of one length."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from motiongen_ardy.model.packed.batch import Batch, PackedBatch
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.graphs import GraphedRows
from motiongen_ardy.model.packed.stack import Group
from motiongen_ardy.model.sampling.projection import RootProjection

Evaluate = Callable[[Batch, Tensor, Tensor, Tensor | None], Tensor]
"""A batch, noisy horizons (Q, G, 5P + L), base steps (Q), which roots to project (Q) -> clean horizons."""


class RecordedBatch(Batch):
    """Sequences of one length, each a row of its own, in the memory that a graph reads."""

    def __init__(
        self,
        last: Tensor,
        observed: tuple[Tensor, Tensor],
        horizon: Sequence[Tensor],
        inputs: Sequence[Tensor],
        *,
        projection: RootProjection | None,
        kept: tuple[Tensor, Tensor] | None,
        history: int,
        num_prefix: int,
        step_position: int,
    ) -> None:
        """Arguments as from `PackedBatch.alike`: (n, ...), horizon and inputs by stage. history: in tokens."""
        count, length, width = inputs[0].shape
        self.num_tokens, self.step_position, self.filled = horizon[0].shape[1], step_position, lambda vectors: vectors
        self.inputs, self.groups, self.slots = tuple(stage.view(-1, width) for stage in inputs), [], []
        self.row_numbers, self.last, self.horizon = list(range(count)), last, tuple(horizon)
        self.projection, self.told, self.kept = projection, (slice(None), *observed), kept
        self._append(Group(0, count, length, num_prefix + history, self.num_tokens), 0, history)


class RecordedSequences:
    """Evaluates batches by replaying recordings: a graph per shape and batch size; smaller batches are padded."""

    def __init__(
        self,
        evaluate: Evaluate,
        graphs: GraphCache,
        *,
        num_stages: int,
        root_width: int,
        num_prefix: int,
        step_position: int,
        keeps_roots: bool,
    ) -> None:
        """keeps_roots: whether rows may come with a kept root; graphs then take a mask that says which rows do."""
        self._evaluate, self._keeps_roots = evaluate, keeps_roots
        self._num_stages, self._root_width = num_stages, root_width
        self._places = {"num_prefix": num_prefix, "step_position": step_position}
        self._rows = GraphedRows(self._recorded, graphs)
        self._slowing_s = 0.0  # the same for all projections of a model

    def __call__(
        self,
        batch: PackedBatch,
        noisy: Tensor,
        step: Tensor,
        active: Tensor | None,
        kept: Sequence[Tensor | None] | None = None,
    ) -> Tensor:
        """As `evaluate`. kept: by row."""
        acting: list[Tensor] = []
        if batch.projection is not None:
            self._slowing_s = batch.projection.slowing_s
            acting = [noisy.new_zeros(len(noisy)) if active is None else active]
        roots = self._kept(batch, noisy, kept or ()) if self._keeps_roots else ()
        result = torch.empty_like(noisy)
        for slot in batch.slots:
            chosen = slice(slot.first, slot.end)
            given = *(part[chosen] for part in (noisy, step, *roots, *acting)), *batch.alike(slot, self._root_width)
            [predicted] = self._rows.of(slot.history, *given)
            result[chosen].copy_(predicted)  # before the next replay
        return result

    def _kept(self, batch: PackedBatch, noisy: Tensor, kept: Sequence[Tensor | None]) -> tuple[Tensor, Tensor]:
        """For each sequence, whether its root is kept (Q, 1, 1), and that root (Q, G, 5P)."""
        none = noisy.new_zeros(noisy.shape[1], self._root_width)
        roots = [kept[row] for row in batch.row_numbers] if kept else []
        if all(root is None for root in roots):
            return noisy.new_zeros(len(noisy), 1, 1, dtype=torch.bool), none.expand(len(noisy), -1, -1)
        which = torch.tensor([root is not None for root in roots]).to(noisy.device)
        return which[:, None, None], torch.stack([none if root is None else root for root in roots])

    def _recorded(self, history: int, noisy: Tensor, step: Tensor, *rest: Tensor) -> tuple[Tensor]:
        stages, kept = self._num_stages, None
        if self._keeps_roots:
            kept, rest = (rest[0], rest[1]), rest[2:]
        projected = len(rest) > 3 + 2 * stages
        active, rest = (rest[0], rest[1:]) if projected else (None, rest)
        last, root, root_mask, *rest = rest
        horizon, projection, inputs = rest[:stages], rest[stages:-stages], rest[-stages:]
        goals = RootProjection.of_tensors(projection, self._slowing_s) if projected else None
        batch = RecordedBatch(
            last,
            (root, root_mask),
            horizon,
            inputs,
            projection=goals,
            kept=kept,
            history=history,
            **self._places,
        )
        return (self._evaluate(batch, noisy, step, active),)
