"""The layout of the rows of one denoising step: one sequence per row and guidance pass, grouped by shape."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from motiongen_ardy.model.packed.conditions import RowConditions
from motiongen_ardy.model.packed.stack import Group
from motiongen_ardy.model.sampling.projection import RootProjection


@dataclass(frozen=True, slots=True)
class SequenceSlot:
    """Where a group's per-step vectors are, as views of the inputs.

    first, end: the group's sequences. step, horizon: by stage. last: of the second stage; None without history.
    history: number of history tokens. group: the group, whose output is read at the horizon.
    """

    first: int
    end: int
    step: tuple[Tensor, ...]
    horizon: tuple[Tensor, ...]
    last: Tensor | None
    history: int
    group: Group


class Sequences:
    """The input of the stages. Between steps, only the slots within `inputs` are written to.

    inputs: by stage, (P, width), the sequences one after another, then zeros. num_tokens: of a horizon.
    """

    inputs: tuple[Tensor, ...]
    groups: list[Group]
    slots: list[SequenceSlot]
    num_tokens: int
    step_position: int

    def _append(self, group: Group, first: int, history: int) -> None:
        """Add a group of sequences and its slot; first: the number of its first sequence."""
        parts = tuple(group.of(stage) for stage in self.inputs)
        has_last = history > 0 and len(parts) > 1
        self.groups.append(group)
        self.slots.append(
            SequenceSlot(
                first,
                first + group.num_sequences,
                step=tuple(part[:, self.step_position] for part in parts),
                horizon=tuple(part[:, group.read] for part in parts),
                last=parts[1][:, group.first_read - 1] if has_last else None,
                history=history,
                group=group,
            )
        )


class FirstStagePart(Sequences):
    """Some of a batch's sequences, for the first stage alone."""

    def __init__(self, whole: Batch, chosen: Sequence[int]) -> None:
        """chosen: ascending numbers of sequences."""
        self.num_tokens, self.step_position = whole.num_tokens, whole.step_position
        members = [(slot, [one - slot.first for one in chosen if slot.first <= one < slot.end]) for slot in whole.slots]
        members = [(slot, ones) for slot, ones in members if ones]
        vectors = whole.inputs[0]
        num_vectors = sum(len(ones) * slot.group.length for slot, ones in members)
        packed = vectors.new_zeros(whole.filled(num_vectors), vectors.shape[-1])
        self.inputs, self.groups, self.slots = (packed,), [], []
        first = start = 0
        for slot, ones in members:
            group = slot.group._replace(start=start, num_sequences=len(ones))
            group.of(packed).copy_(slot.group.of(vectors)[ones])
            self._append(group, first, slot.history)
            first, start = first + len(ones), group.end


class Batch(Sequences):
    """The sequences of one evaluation.

    row_numbers: each sequence's row among those of the step. last: (Q, 1, 5P + L), last history tokens.
    horizon: by stage, (Q, G, width), what is added to the horizon's vectors.
    projection: of every sequence; None if no row has one.
    told: the sequences (C) that see constraints, with their observed root and its mask (C, G, 5P); None if there are
    none.
    kept: (Q, 1, 1) bool, the sequences whose root is kept, and those roots (Q, G, 5P); None if given by row instead.
    filled: the padded number of vectors for a number of vectors.
    """

    row_numbers: list[int]
    last: Tensor
    horizon: tuple[Tensor, ...]
    projection: RootProjection | None = None
    told: tuple[Tensor | slice, Tensor, Tensor] | None = None
    kept: tuple[Tensor, Tensor] | None = None
    filled: Callable[[int], int]
    _part: tuple[tuple[int, ...], FirstStagePart] | None = None

    def first_stage_part(self, chosen: Sequence[int]) -> FirstStagePart:
        """Some of the sequences, for the first stage alone; cached, since most steps choose the same ones."""
        key = tuple(chosen)
        if self._part is None or self._part[0] != key:
            self._part = key, FirstStagePart(self, key)
        return self._part[1]


class PackedBatch(Batch):
    """Rows laid out as sequences. rows: (Q), the row numbers; weight: (Q, 1, 1). num_vectors: without padding."""

    def __init__(
        self,
        rows: Sequence[RowConditions],
        sequences: Sequence[tuple[int, int]],
        horizon_of: Callable[[int], Tensor],
        step_position: int,
        filled: Callable[[int], int] = lambda vectors: vectors,
    ) -> None:
        """sequences: (row, pass) pairs, sorted by shape. horizon_of: history tokens -> positions (S, G, width)."""
        device = rows[0].last.device
        self.num_tokens = horizon_of(0).shape[1]
        self.step_position, self.filled = step_position, filled
        self.row_numbers = [row for row, _ in sequences]
        self.rows = torch.tensor(self.row_numbers, device=device)
        self.weight = torch.tensor([rows[row].passes[index].weight for row, index in sequences], device=device)[
            :, None, None
        ]
        self.last = torch.stack([rows[row].last for row, _ in sequences])[:, None]
        self._lay_out(rows, sequences, horizon_of)
        self._note_goals(rows, sequences)
        self.projection = _projection_of([rows[row].projection for row, _ in sequences])
        self._observed: tuple[Tensor, Tensor] | None = None

    def alike(self, slot: SequenceSlot, root_width: int) -> tuple[Tensor, ...]:
        """The arguments of a `RecordedBatch` for a group's n sequences: tensors (n, ...), each as in `Batch`.

        The last history tokens; observed roots and their mask (zeros without constraints); by stage, what is added to
        the horizon's vectors; the projection's tensors, if there is one; by stage, the inputs.
        """
        if self._observed is None:
            shape = len(self.row_numbers), self.num_tokens, root_width
            self._observed = self.last.new_zeros(shape), self.last.new_zeros(shape)
            if self.told is not None:
                where, *seen = self.told
                for whole, part in zip(self._observed, seen, strict=True):
                    whole[where] = part
        projection = () if self.projection is None else self.projection.tensors()
        parts = self.last, *self._observed, *self.horizon, *projection
        inputs = (slot.group.of(stage) for stage in self.inputs)
        return *(part[slot.first : slot.end] for part in parts), *inputs

    def _lay_out(
        self,
        rows: Sequence[RowConditions],
        sequences: Sequence[tuple[int, int]],
        horizon_of: Callable[[int], Tensor],
    ) -> None:
        shapes = [(rows[row].history_tokens, rows[row].future_tokens(index)) for row, index in sequences]
        num_stages, num_prefix, width = rows[0].prefixes[0].shape
        lengths = [num_prefix + history + self.num_tokens + future for history, future in shapes]
        self.num_vectors = sum(lengths)
        self.inputs = tuple(rows[0].last.new_zeros(num_stages, self.filled(self.num_vectors), width))
        added = []
        self.groups, self.slots = [], []
        first = start = 0
        while first < len(sequences):
            shape = shapes[first]
            end = next((later for later in range(first, len(sequences)) if shapes[later] != shape), len(sequences))
            members = [(rows[row], index) for row, index in sequences[first:end]]
            history, future = shape
            begin, after = num_prefix + history, num_prefix + history + self.num_tokens
            group = Group(start, end - first, lengths[first], begin, self.num_tokens)
            parts = tuple(group.of(stage) for stage in self.inputs)
            prefix = torch.stack([row.prefixes[index] for row, index in members], dim=1)
            horizon = horizon_of(history)[:, None].expand(-1, end - first, -1, -1)
            goals = [row.told(index) for row, index in members]
            if any(one is not None for one in goals):
                zeros = torch.zeros_like(horizon[:, 0])
                horizon = horizon + torch.stack([zeros if one is None else one.horizon for one in goals], dim=1)
            added.append(horizon)
            for number, part in enumerate(parts):
                part[:, :num_prefix] = prefix[number]
                if future:
                    part[:, after:] = torch.stack([one.future[number] for one in goals if one is not None])
            if history:
                parts[0][:, num_prefix:begin] = torch.stack([row.history for row, _ in members])
                if num_stages > 1 and history > 1:
                    parts[1][:, num_prefix : begin - 1] = torch.stack([row.decided for row, _ in members])
            self._append(group, first, history)
            first, start = end, group.end
        self.horizon = torch.cat(added, dim=1).unbind()

    def _note_goals(self, rows: Sequence[RowConditions], sequences: Sequence[tuple[int, int]]) -> None:
        told = [(position, rows[row].told(index)) for position, (row, index) in enumerate(sequences)]
        known = [(position, goals) for position, goals in told if goals is not None]
        if known:
            self.told = (
                torch.tensor([position for position, _ in known], device=self.rows.device),
                torch.stack([goals.root for _, goals in known]),
                torch.stack([goals.root_mask for _, goals in known]),
            )


def _projection_of(rows: Sequence[RootProjection | None]) -> RootProjection | None:
    """The projections of sequences in one; sequences without one get a projection without goals."""
    known = next((row for row in rows if row is not None), None)
    if known is None:
        return None
    none = known.none()
    return RootProjection.stacked([none if row is None else row for row in rows])
