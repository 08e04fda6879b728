"""PackedDenoiser: guided predictions for rows that differ in history, future, text, constraints and guidance.

What the plain denoiser computes at each step is computed once per window: text and heading vectors, history vectors
(except the last token's second-stage vector, whose velocity depends on the prediction), future vectors, and what
constraints add to the horizon's vectors. There are no hidden tokens, and no passes that guidance does not need.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from motiongen_ardy.core.representation import LOCAL_ROOT_WIDTH
from motiongen_ardy.model.denoiser.base import Denoiser
from motiongen_ardy.model.denoiser.guidance import Pass
from motiongen_ardy.model.denoiser.two_stage import TwoStageDenoiser
from motiongen_ardy.model.packed.batch import Batch, PackedBatch, Sequences
from motiongen_ardy.model.packed.conditions import RowConditions, RowGoals, WindowVectors
from motiongen_ardy.model.packed.goal_layers import GoalLayer, TokenGoals, ToldTokens
from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.input_layer import InputLayer
from motiongen_ardy.model.packed.recorded import RecordedSequences
from motiongen_ardy.model.packed.stage import PackedStage
from motiongen_ardy.model.sampling.projection import RootProjection
from motiongen_ardy.model.tokenizer.model import by_token, root_from_tokens


class PackedDenoiser:
    """A denoiser's weights as they are served, and their evaluation. Inputs and outputs are float32."""

    def __init__(
        self,
        denoiser: Denoiser,
        num_base_steps: int,
        horizon: int,
        dtype: torch.dtype,
        graphs: GraphCache | None = None,
        keeps_roots: bool = True,
    ) -> None:
        """horizon: frames that a window generates. dtype: of the transformers' products, float32 or bfloat16.

        graphs: recorded graphs to replay; None: evaluate directly. keeps_roots: whether rows may come with a kept root;
        with graphs, the root is predicted all the same.
        """
        self._denoiser = denoiser
        self._layout = denoiser.representation
        self._patch = denoiser.config.patch
        self._root_width = denoiser.config.root_token_width
        self._num_tokens = horizon // self._patch
        latent_dim = denoiser.config.latent_dim
        device = denoiser.global_root_hybrid_proj.weight.device
        self.stages = [PackedStage(denoiser.root_model, num_base_steps, dtype)]
        # The released layer that reads constraints has the latent before the root; tokens have the root first.
        order = torch.cat([torch.arange(self._root_width) + latent_dim, torch.arange(latent_dim)]).to(device)
        told = denoiser.global_root_hybrid_constraints_proj
        self._projections = [InputLayer(denoiser.global_root_hybrid_proj, told, order, self._patch)]
        if isinstance(denoiser, TwoStageDenoiser):
            self.stages.append(PackedStage(denoiser.body_model, num_base_steps, dtype))
            order = torch.arange(LOCAL_ROOT_WIDTH * self._patch + latent_dim, device=device)
            told = denoiser.local_root_hybrid_constraints_proj
            self._projections.append(InputLayer(denoiser.local_root_hybrid_proj, told, order, self._patch))
        future = denoiser.future_constraints_proj
        self._future = None if future is None else GoalLayer.of(future, self._patch)
        self._recorded = (
            None
            if graphs is None
            else RecordedSequences(
                self._evaluated,
                graphs,
                num_stages=len(self.stages),
                root_width=self._root_width,
                num_prefix=self.stages[0].num_prefix,
                step_position=self.stages[0].step_position,
                keeps_roots=keeps_roots and len(self.stages) > 1,
            )
        )
        self._step_vectors = torch.stack([stage.step_vectors for stage in self.stages])
        self._horizon_positions: dict[int, Tensor] = {}

    def release_originals(self) -> None:
        """Free the transformers' weight matrices, of which this holds copies; the denoiser itself becomes unusable."""
        for stage in self.stages:
            stage.stack.release_originals()

    # ---- once a window ----------------------------------------------------------------------------------------------

    @torch.inference_mode()
    def vectors(self, history: Tensor, text: Tensor, heading: Tensor) -> WindowVectors:
        """What the rows of one history length see in all steps, apart from constraints.

        history: (B, N_h, 5P + L), recentred. text: (B, n, W), zeros for no text; heading: (B) radians, of the first
        frame.
        """
        prefixes = [stage.prefixes(text, heading) for stage in self.stages]
        told, untold = (torch.stack(kind, dim=1) for kind in zip(*prefixes, strict=True))
        last = history[:, -1] if history.shape[1] else history.new_zeros(len(history), history.shape[2])
        return WindowVectors(told, untold, *self._history_vectors(history), last)

    @torch.inference_mode()
    def conditions(
        self,
        vectors: WindowVectors,
        passes: Sequence[tuple[Pass, ...]],
        goals: Sequence[RowGoals | None],
        projections: Sequence[RootProjection | None],
    ) -> list[RowConditions]:
        """What stays constant while the windows of B rows are denoised.

        passes: those that each row's guidance needs. projections: of each row alone, what its root is projected onto.
        """
        kinds = zip(vectors.untold.unbind(), vectors.told.unbind(), strict=True)
        prefixes = [tuple(kind[one.with_text] for one in of_row) for kind, of_row in zip(kinds, passes, strict=True)]
        tensors = vectors.history.unbind(), vectors.decided.unbind(), vectors.last.unbind()
        by_row = zip(passes, prefixes, *tensors, goals, projections, strict=True)
        return [RowConditions(*parts) for parts in by_row]

    def _history_vectors(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        count = tokens.shape[1]
        history = self.stages[0].placed(self._projections[0].plain(tokens), count, 0)
        if len(self.stages) == 1 or count == 0:
            return history, history[:, :0]
        decided = self._local(tokens)[:, :-1]
        return history, self.stages[1].placed(self._projections[1].plain(decided), count, 0)

    @torch.inference_mode()
    def goals(
        self, observed: Tensor, mask: Tensor, history_tokens: int, mask_on_host: Tensor | None = None
    ) -> list[RowGoals | None]:
        """The constraints of each of B rows, as the stages read them.

        observed, mask: (B, PN, D), in the window's own frame, zero in the history; observed is zero where the mask is.
        mask_on_host: a copy on the CPU, if there is one; it shows how much there is to compute.
        """
        num_rows, future = len(mask), self._future
        if future is None:
            return [None] * num_rows
        end = history_tokens + self._num_tokens
        on_host = mask.cpu() if mask_on_host is None else mask_on_host
        which = ToldTokens.of(on_host.unflatten(1, (-1, self._patch)), end)  # few; all other tokens add zero
        rows, numbers = torch.stack([which.rows, which.numbers]).to(mask.device).unbind()
        seen = (part.unflatten(1, (-1, self._patch))[rows, numbers] for part in (observed, mask))
        told = TokenGoals.of(*seen, which.beyond_root)
        within, ahead = told.between(0, which.num_here), told.between(which.num_here, len(rows))
        at = rows[: which.num_here], numbers[: which.num_here] - history_tokens

        def over_horizon(values: Tensor) -> Tensor:
            whole = values.new_zeros(num_rows, self._num_tokens, values.shape[-1])
            whole[at] = values
            return whole

        added = torch.stack([over_horizon(one.added_by(within)) for one in self._projections], dim=1)
        vectors = future(ahead)
        behind = numbers[which.num_here :]
        placed = torch.stack([stage.placed_at(vectors, history_tokens, behind) for stage in self.stages])
        root, root_mask = over_horizon(within.root).unbind(), over_horizon(within.root_mask).unbind()
        return [
            RowGoals(*parts)
            for parts in zip(added.unbind(), placed.split(which.num_ahead, dim=1), root, root_mask, strict=True)
        ]

    # ---- once a change of the batch ---------------------------------------------------------------------------------

    @torch.inference_mode()
    def batch(self, rows: Sequence[RowConditions]) -> PackedBatch:
        """Lay the rows out for any number of steps; sequences of the same shape are adjacent."""
        sequences = [(row, index) for row, conditions in enumerate(rows) for index in range(len(conditions.passes))]
        sequences.sort(key=lambda pair: (rows[pair[0]].history_tokens, rows[pair[0]].future_tokens(pair[1])))
        # Batches that are replayed from graphs are padded there.
        filled = (lambda vectors: vectors) if self._recorded is not None else self.stages[0].stack.filled
        return PackedBatch(rows, sequences, self._horizon_of, self.stages[0].step_position, filled)

    def _horizon_of(self, history_tokens: int) -> Tensor:
        """(S, G, width): the positions of the horizon's tokens."""
        held = self._horizon_positions.get(history_tokens)
        if held is None:
            zeros = self.stages[0].step_vectors.new_zeros(self._num_tokens, self.stages[0].step_vectors.shape[-1])
            held = torch.stack([stage.placed(zeros, history_tokens, history_tokens) for stage in self.stages])
            self._horizon_positions[history_tokens] = held
        return held

    # ---- once a step ------------------------------------------------------------------------------------------------

    @torch.inference_mode()
    def predict(
        self,
        batch: PackedBatch,
        tokens: Tensor,
        step: Tensor,
        project: Sequence[bool] | None = None,
        kept: Sequence[Tensor | None] | None = None,
    ) -> Tensor:
        """The guided clean horizon (R, G, 5P + L) from noisy horizon tokens of that shape; step: (R) base steps.

        project: for each row, whether its root is projected onto its goals in this step; None: no row. kept: for each
        row, its clean root (G, 5P) as predicted in an earlier step, or None to predict it; ignored by a denoiser with a
        single stage.
        """
        noisy, step = tokens[batch.rows], step[batch.rows]
        active = None
        if batch.projection is not None and project is not None and any(project):
            active = torch.tensor(project, device=tokens.device, dtype=tokens.dtype)[batch.rows]
        if self._recorded is not None:
            result = self._recorded(batch, noisy, step, active, kept)
        else:
            result = self._evaluated(batch, noisy, step, active, kept)
        return torch.zeros_like(tokens).index_add_(0, batch.rows, result * batch.weight)

    def _evaluated(
        self,
        batch: Batch,
        noisy: Tensor,
        step: Tensor,
        active: Tensor | None,
        kept: Sequence[Tensor | None] | None = None,
    ) -> Tensor:
        """The clean horizon (Q, G, 5P + L) of each sequence, from noisy horizons of that shape, which are overwritten.

        step: (Q) base steps. active: (Q), 1 to project the root onto its goals, else 0; None: none. kept: by row.
        """
        step_vectors = self._step_vectors[:, step]
        result = self._first_stage(batch, noisy, step_vectors, kept)
        if active is not None:
            result = self._on_goals(batch, result, active)
        if len(self.stages) == 1:
            return result
        latent = noisy[..., self._root_width :]
        known = self._local(torch.cat([batch.last, torch.cat([result, latent], dim=-1)], dim=1))
        for slot in batch.slots:
            if slot.last is not None:
                # One vector per sequence, side by side: a batch of products with one vector each is slower.
                vectors = self._projections[1].plain(known[slot.first : slot.end, 0])
                slot.last.copy_(self.stages[1].placed(vectors[:, None], slot.history, slot.history - 1)[:, 0])
        horizon = self._projections[1].noisy.plus(known[:, 1:], batch.horizon[1])
        return torch.cat([result, self._run(batch, 1, step_vectors[1], horizon)], dim=-1)

    def _first_stage(
        self, batch: Batch, noisy: Tensor, step_vectors: Tensor, kept: Sequence[Tensor | None] | None
    ) -> Tensor:
        """The first stage's prediction (Q, G, 5P or more); for sequences whose root is kept, that root."""
        roots = enumerate(kept[row] for row in batch.row_numbers) if kept and len(self.stages) > 1 else ()
        known = {number: root for number, root in roots if root is not None}
        missing = [number for number in range(len(batch.row_numbers)) if number not in known]
        if not missing:
            return torch.stack(list(known.values()))
        if batch.told is not None:
            where, root, root_mask = batch.told
            noisy[where, :, : self._root_width] = noisy[where, :, : self._root_width] * (1 - root_mask) + root
        project = self._projections[0].noisy
        if not known:
            predicted = self._run(batch, 0, step_vectors[0], project.plus(noisy, batch.horizon[0]))
            return predicted if batch.kept is None else torch.where(*batch.kept, predicted)
        horizon = project.plus(noisy[missing], batch.horizon[0][missing])
        predicted = self._run(batch.first_stage_part(missing), 0, step_vectors[0][missing], horizon)
        result = predicted.new_empty(len(batch.row_numbers), *predicted.shape[1:])
        result[missing] = predicted
        result[list(known)] = torch.stack(list(known.values()))
        return result

    def _run(self, sequences: Sequences, number: int, step_vectors: Tensor, horizon: Tensor) -> Tensor:
        """A stage's prediction (Q, G, its output). step_vectors: (Q, width); horizon: (Q, G, width)."""
        for slot in sequences.slots:
            slot.step[number].copy_(step_vectors[slot.first : slot.end])
            slot.horizon[number].copy_(horizon[slot.first : slot.end])
        stage = self.stages[number]
        encoded = stage.stack(sequences.inputs[number], sequences.groups)
        return stage.output(encoded.unflatten(0, (-1, sequences.num_tokens)))

    def _on_goals(self, batch: Batch, result: Tensor, active: Tensor) -> Tensor:
        """Predictions (Q, G, 5P or more), with the roots of active sequences (Q) projected onto their goals."""
        if batch.projection is None:
            return result
        root = batch.projection.apply(self._layout, root_from_tokens(result, self._patch), active)
        return torch.cat([by_token(root, self._patch), result[..., self._root_width :]], dim=-1)

    def _local(self, tokens: Tensor) -> Tensor:
        """Hybrid tokens (B, N, 5P + L) with their root made local: (B, N, 4P + L)."""
        lengths = torch.full((tokens.shape[0],), tokens.shape[1] * self._patch, device=tokens.device)
        local = by_token(self._layout.local_root(root_from_tokens(tokens, self._patch), lengths), self._patch)
        return torch.cat([local, tokens[..., self._root_width :]], dim=-1)
