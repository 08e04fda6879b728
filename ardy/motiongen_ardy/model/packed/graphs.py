"""Functions of rows replayed as recorded graphs, where starting kernels takes longer than they do.

A graph is of one shape and of its own memory. So batches are filled up to few sizes, their rows copied to where the
graph reads them, and the result copied from where it writes. What a row gets does not depend on the others, so those
that fill up may be anything. What comes too seldom for a graph is called.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from typing import TypeAlias

import torch
from torch import Tensor

from motiongen_ardy.model.packed.graph_cache import GraphCache

SIZES = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
"""Rows of a batch. More than the last are filled up to a multiple of it."""

RowWork: TypeAlias = Callable[..., tuple[Tensor, ...]]
"""Tensors (B, ...) -> tensors (B, ...)."""


class GraphedRows:
    """Does what a function of rows does, by recordings of it: a graph for each number of rows that fewer fill up.

    What a row gets must not depend on the others, and nothing in the function may wait for the device.
    """

    def __init__(self, work: RowWork, graphs: GraphCache) -> None:
        self._work = work
        self._graphs = graphs

    def __call__(self, *rows: Tensor) -> tuple[Tensor, ...]:
        """What the function gives for tensors (B, ...). It is to be taken before anything else is replayed."""
        return self._done(None, self._work, rows)

    def of(self, kind: Hashable, *rows: Tensor) -> tuple[Tensor, ...]:
        """The same by a function that is given a kind of rows before them."""
        return self._done(kind, partial(self._work, kind), rows)

    def _done(self, kind: Hashable, work: RowWork, rows: Sequence[Tensor]) -> tuple[Tensor, ...]:
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


def sizes_up_to(most: int, passes: int = 1) -> list[int]:
    """Numbers of rows that graphs are recorded for where there are never more than so many, rising.

    passes: sequences of each row in an evaluation, of which all numbers are to be recorded, too.
    """
    return sorted({size for size in (*SIZES, *(each // passes for each in SIZES)) if 0 < size < most} | {most})


def filled_size(rows: int) -> int:
    """The size that so many rows are filled up to."""
    if rows > SIZES[-1]:
        return -(-rows // SIZES[-1]) * SIZES[-1]
    return SIZES[bisect_left(SIZES, rows)]
