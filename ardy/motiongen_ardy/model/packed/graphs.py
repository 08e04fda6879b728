"""GraphedStack: transformer layers replayed as one recorded graph, where starting kernels takes longer than they do.

A graph is of one shape and of its own memory. So batches are filled up to few sizes, their vectors copied to where the
graph reads them, and the result copied from where it writes. What a sequence gets does not depend on the others, so
those that fill up may be anything; they are zeros.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

import torch
from torch import Tensor

from motiongen_ardy.model.packed.stack import Group

MOST_GRAPHS = 64
"""Those that were not replayed for longest go first."""
SIZES = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
"""Sequences of a group. More than the last are filled up to a multiple of it."""
_WARM_UPS = 3

Stack: TypeAlias = Callable[[Tensor, Sequence[Group]], Tensor]
"""(P, width) vectors, and the groups that they are one behind another -> (R, width), those that are read."""


class GraphRecorder(Protocol):
    """Makes work that can be replayed."""

    def record(self, work: Callable[[], Tensor]) -> tuple[Callable[[], None], Tensor]:
        """What does the work again, on the memory it was recorded with, and the tensor that it leaves its result in.

        Results of two recordings may share memory: each is to be taken before the next replay.
        """
        ...


class CudaGraphRecorder:
    """Records CUDA graphs, which share one pool of memory. For one device and one thread."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pool = torch.cuda.graph_pool_handle()

    def record(self, work: Callable[[], Tensor]) -> tuple[Callable[[], None], Tensor]:
        # Libraries choose their kernels and take their memory when they are first called, which must not be recorded.
        aside = torch.cuda.Stream(self._device)
        aside.wait_stream(torch.cuda.current_stream(self._device))
        with torch.cuda.stream(aside):
            for _ in range(_WARM_UPS):
                work()
        torch.cuda.current_stream(self._device).wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph, pool=self._pool):
            result = work()
        return graph.replay, result


class _Recorded:
    """One graph. read_from: (P, width), by group filled up; result: (R, width), what is read of it."""

    def __init__(self, stack: Stack, groups: tuple[Group, ...], like: Tensor, recorder: GraphRecorder) -> None:
        self.groups = groups
        self.read_from = like.new_zeros(self.groups[-1].end, like.shape[-1])
        self.replay, self.result = recorder.record(lambda: stack(self.read_from, self.groups))


class GraphedStack:
    """Does what a stack does, by recordings of it. num_recorded: how many were made in all."""

    def __init__(self, stack: Stack, recorder: GraphRecorder, most: int = MOST_GRAPHS) -> None:
        self._stack = stack
        self._recorder = recorder
        self._most = most
        self._recorded: OrderedDict[tuple[Group, ...], _Recorded] = OrderedDict()
        self.num_recorded = 0

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """What is read (R, width) of vectors (P, width) float32, the groups one behind another.

        The argument is not changed.
        """
        recorded = self._of(vectors, groups)
        for given, filled in zip(groups, recorded.groups, strict=True):
            size = given.end - given.start
            recorded.read_from[filled.start : filled.start + size].copy_(vectors[given.start : given.end])
        recorded.replay()
        parts = recorded.result.split([filled.total_read for filled in recorded.groups])
        parts = [part[: given.total_read] for given, part in zip(groups, parts, strict=True)]
        return torch.cat(parts)  # a copy also of a single one: the next replay overwrites the result

    def _of(self, vectors: Tensor, groups: Sequence[Group]) -> _Recorded:
        start, filled = 0, []
        for group in groups:
            filled.append(group._replace(start=start, num_sequences=filled_size(group.num_sequences)))
            start = filled[-1].end
        key = tuple(filled)
        held = self._recorded.get(key)
        if held is not None:
            self._recorded.move_to_end(key)
            return held
        if len(self._recorded) >= self._most:
            self._recorded.popitem(last=False)
        self._recorded[key] = held = _Recorded(self._stack, key, vectors, self._recorder)
        self.num_recorded += 1
        return held


def filled_size(sequences: int) -> int:
    """The size that so many sequences of a group are filled up to."""
    if sequences > SIZES[-1]:
        return -(-sequences // SIZES[-1]) * SIZES[-1]
    return SIZES[bisect_left(SIZES, sequences)]
