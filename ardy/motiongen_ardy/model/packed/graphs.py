"""Row functions replayed as recorded graphs, for work whose kernels take longer to launch than to run.

A graph has one shape and its own memory. Batches are therefore padded to a few sizes, their rows are copied to where
the graph reads them, and results are copied from where it writes. Since a row's result does not depend on the others,
the padding may be anything. Shapes that are too rare for a graph are computed by ordinary calls.
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
"""Batch sizes in rows. Larger batches are padded to a multiple of the last."""

RowWork: TypeAlias = Callable[..., tuple[Tensor, ...]]
"""Tensors (B, ...) -> tensors (B, ...)."""


class GraphedRows:
    """Replays recordings of a row function, one for each batch size; smaller batches are padded.

    A row's result must not depend on the other rows, and the function must not synchronise with the device.
    """

    def __init__(self, work: RowWork, graphs: GraphCache) -> None:
        self._work = work
        self._graphs = graphs

    def __call__(self, *rows: Tensor) -> tuple[Tensor, ...]:
        """The function's result for tensors (B, ...). It is valid only until the next replay of any graph."""
        return self._done(None, self._work, rows)

    def of(self, kind: Hashable, *rows: Tensor) -> tuple[Tensor, ...]:
        """The same, for a function whose first argument is a kind."""
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
    """The same function with copied results: those of a replay are valid only until the next one."""
    return lambda *rows: tuple(part.clone() for part in work(*rows))


def sizes_up_to(most: int, passes: int = 1) -> list[int]:
    """Ascending batch sizes to record graphs for if there are never more than `most` rows.

    passes: sequences per row in an evaluation; all sizes in sequences are to be covered too.
    """
    return sorted({size for size in (*SIZES, *(each // passes for each in SIZES)) if 0 < size < most} | {most})


def filled_size(rows: int) -> int:
    """The size to which a batch of `rows` rows is padded."""
    if rows > SIZES[-1]:
        return -(-rows // SIZES[-1]) * SIZES[-1]
    return SIZES[bisect_left(SIZES, rows)]
