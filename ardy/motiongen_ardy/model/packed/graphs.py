"""Work replayed as recorded graphs, where starting kernels takes longer than they do: layers, functions of rows.

A graph is of one shape and of its own memory. So batches are filled up to few sizes, their vectors copied to where the
graph reads them, and the result copied from where it writes. What a sequence gets does not depend on the others, so
those that fill up may be anything; they are zeros. What comes too seldom for a graph is called.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Hashable, Sequence
from typing import TypeAlias

import torch
from torch import Tensor

from motiongen_ardy.model.packed.graph_cache import GraphCache
from motiongen_ardy.model.packed.stack import Group

SIZES = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
"""Sequences of a group. More than the last are filled up to a multiple of it."""

RowWork: TypeAlias = Callable[..., tuple[Tensor, ...]]
"""Tensors (B, ...) -> tensors (B, ...)."""
Stack: TypeAlias = Callable[[Tensor, Sequence[Group]], Tensor]
"""(P, width) vectors, and the groups that they are one behind another -> (R, width), those that are read."""


class GraphedStack:
    """Does what a stack does, by recordings of it: a graph for each shape and number of sequences, that fewer fill up.

    Groups are replayed one by one: of what may come together in a batch there would be no end.
    """

    def __init__(self, stack: Stack, graphs: GraphCache) -> None:
        self._stack = stack
        self._graphs = graphs

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """What is read (R, width) of vectors (P, width) float32, the groups one behind another.

        The argument is not changed.
        """
        read = vectors.new_empty(sum(group.total_read for group in groups), vectors.shape[-1])
        end = 0
        for group in groups:
            begin, end = end, end + group.total_read
            read[begin:end].copy_(self._read_of(group, vectors[group.start : group.end]))  # before the next replay
        return read

    def _read_of(self, group: Group, vectors: Tensor) -> Tensor:
        filled = group._replace(start=0, num_sequences=filled_size(group.num_sequences))

        def begin() -> tuple[list[Tensor], Callable[[], Tensor]]:
            read_from = vectors.new_zeros(filled.end, vectors.shape[-1])
            return [read_from], lambda: self._stack(read_from, [filled])

        graph = self._graphs.of((self, filled), begin)
        if graph is None:
            return self._stack(vectors, [group._replace(start=0)])
        graph.read_from[0][: len(vectors)].copy_(vectors)
        graph.replay()
        return graph.result[: group.total_read]


class GraphedRows:
    """Does what a function of rows does, by recordings of it: a graph for each number of rows that fewer fill up.

    What a row gets must not depend on the others, and nothing in the function may wait for the device.
    """

    def __init__(self, work: RowWork, graphs: GraphCache) -> None:
        self._work = work
        self._graphs = graphs

    def __call__(self, *rows: Tensor) -> tuple[Tensor, ...]:
        """What the function gives for tensors (B, ...). It is to be taken before anything else is replayed."""
        return self.of(None, self._work, *rows)

    def of(self, kind: Hashable, work: RowWork, *rows: Tensor) -> tuple[Tensor, ...]:
        """The same by another function for each kind of rows."""
        count = len(rows[0])
        shapes = tuple(torch.Size((filled_size(count), *part.shape[1:])) for part in rows)

        def begin() -> tuple[list[Tensor], Callable[[], tuple[Tensor, ...]]]:
            read_from = [part.new_zeros(shape) for part, shape in zip(rows, shapes, strict=True)]
            return read_from, lambda: work(*read_from)

        graph = self._graphs.of((self, kind, shapes), begin)
        if graph is None:
            return work(*rows)
        for given, read in zip(rows, graph.read_from, strict=True):
            read[:count].copy_(given)
        graph.replay()
        return tuple(part[:count] for part in graph.result)


def keeping(work: RowWork) -> RowWork:
    """The same, but what it gives may be kept: results of a replay last until the next."""
    return lambda *rows: tuple(part.clone() for part in work(*rows))


def sizes_up_to(most: int) -> list[int]:
    """Numbers of sequences, or rows, that graphs are recorded for where there are never more than so many, rising."""
    return [*(size for size in SIZES if size < most), most]


def filled_size(sequences: int) -> int:
    """The size that so many sequences of a group are filled up to."""
    if sequences > SIZES[-1]:
        return -(-sequences // SIZES[-1]) * SIZES[-1]
    return SIZES[bisect_left(SIZES, sequences)]
