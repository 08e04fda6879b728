"""Work replayed as recorded graphs, where starting kernels takes longer than they do: layers, functions of rows.

A graph is of one shape and of its own memory. So batches are filled up to few sizes, their vectors copied to where the
graph reads them, and the result copied from where it writes. What a sequence gets does not depend on the others, so
those that fill up may be anything; they are zeros.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeAlias, TypeVar

import torch
from torch import Tensor

from motiongen_ardy.model.packed.stack import Group

MOST_GRAPHS = 64
"""Those that were not replayed for longest go first."""
SIZES = (1, 2, 4, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
"""Sequences of a group. More than the last are filled up to a multiple of it."""
_WARM_UPS = 3

Key, Recording, Result = TypeVar("Key"), TypeVar("Recording"), TypeVar("Result")
RowWork: TypeAlias = Callable[..., tuple[Tensor, ...]]
"""Tensors (B, ...) -> tensors (B, ...)."""
Stack: TypeAlias = Callable[[Tensor, Sequence[Group]], Tensor]
"""(P, width) vectors, and the groups that they are one behind another -> (R, width), those that are read."""


class GraphRecorder(Protocol):
    """Makes work that can be replayed."""

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        """What does the work again, on the memory it was recorded with, and the tensors that it leaves its result in.

        Results of two recordings may share memory: each is to be taken before the next replay.
        """
        ...


class CudaGraphRecorder:
    """Records CUDA graphs, which share one pool of memory. For one device and one thread."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._pool = torch.cuda.graph_pool_handle()

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        with torch.cuda.device(self._device):
            return self._record(work)

    def _record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        # Libraries choose their kernels and take their memory when they are first called, which must not be recorded.
        aside = torch.cuda.Stream(self._device)
        aside.wait_stream(torch.cuda.current_stream(self._device))
        with torch.cuda.stream(aside):
            for _ in range(_WARM_UPS):
                work()
        torch.cuda.current_stream(self._device).wait_stream(aside)
        graph = torch.cuda.CUDAGraph()
        # What other threads do meanwhile, as to load another model, is no part of it and need not be held up.
        with torch.cuda.graph(graph, pool=self._pool, capture_error_mode="thread_local"):
            result = work()
        return graph.replay, result


class _Recordings(Generic[Key, Recording]):
    """The most that are kept, by what they were recorded for. num_recorded: how many were made in all."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: OrderedDict[Key, Recording] = OrderedDict()
        self.num_recorded = 0

    def of(self, key: Key, record: Callable[[], Recording]) -> Recording:
        held = self._held.get(key)
        if held is None:
            if len(self._held) >= self._most:
                self._held.popitem(last=False)
            held = self._held[key] = record()
            self.num_recorded += 1
        self._held.move_to_end(key)
        return held


class _Recorded(Generic[Result]):
    """One graph. read_from: what is written before it is replayed; result: what is read after."""

    def __init__(self, read_from: Sequence[Tensor], work: Callable[[], Result], recorder: GraphRecorder) -> None:
        self.read_from = read_from
        self.replay, self.result = recorder.record(work)


class GraphedStack:
    """Does what a stack does, by recordings of it: a graph for each shape and number of sequences, that fewer fill up.

    Groups are replayed one by one: of what may come together in a batch there would be no end.
    """

    def __init__(self, stack: Stack, recorder: GraphRecorder, most: int = MOST_GRAPHS) -> None:
        self._stack = stack
        self._recorder = recorder
        self._recordings: _Recordings[Group, _Recorded[Tensor]] = _Recordings(most)

    @property
    def num_recorded(self) -> int:
        """How many graphs were made in all."""
        return self._recordings.num_recorded

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """What is read (R, width) of vectors (P, width) float32, the groups one behind another.

        The argument is not changed.
        """
        read = vectors.new_empty(sum(group.total_read for group in groups), vectors.shape[-1])
        begin = 0
        for group in groups:
            recorded = self._of(group, vectors)
            recorded.read_from[0][: group.end - group.start].copy_(vectors[group.start : group.end])
            recorded.replay()
            end = begin + group.total_read
            read[begin:end].copy_(recorded.result[: group.total_read])  # what the next replay overwrites
            begin = end
        return read

    def _of(self, group: Group, like: Tensor) -> _Recorded[Tensor]:
        filled = group._replace(start=0, num_sequences=filled_size(group.num_sequences))

        def record() -> _Recorded[Tensor]:
            read_from = like.new_zeros(filled.end, like.shape[-1])
            return _Recorded([read_from], lambda: self._stack(read_from, [filled]), self._recorder)

        return self._recordings.of(filled, record)


class GraphedRows:
    """Does what a function of rows does, by recordings of it: a graph for each number of rows that fewer fill up.

    What a row gets must not depend on the others, and nothing in the function may wait for the device.
    """

    def __init__(self, work: RowWork, recorder: GraphRecorder, most: int = MOST_GRAPHS) -> None:
        self._work = work
        self._recorder = recorder
        self._recordings: _Recordings[tuple[torch.Size, ...], _Recorded[tuple[Tensor, ...]]] = _Recordings(most)

    @property
    def num_recorded(self) -> int:
        """How many graphs were made in all."""
        return self._recordings.num_recorded

    def __call__(self, *rows: Tensor) -> tuple[Tensor, ...]:
        """What the function gives for tensors (B, ...). It is to be taken before anything else is replayed."""
        count = len(rows[0])
        shapes = tuple(torch.Size((filled_size(count), *part.shape[1:])) for part in rows)
        recorded = self._recordings.of(shapes, lambda: self._record(rows, shapes))
        for given, read in zip(rows, recorded.read_from, strict=True):
            read[:count].copy_(given)
        recorded.replay()
        return tuple(part[:count] for part in recorded.result)

    def _record(self, like: Sequence[Tensor], shapes: Sequence[torch.Size]) -> _Recorded[tuple[Tensor, ...]]:
        read_from = [part.new_zeros(shape) for part, shape in zip(like, shapes, strict=True)]
        return _Recorded(read_from, lambda: self._work(*read_from), self._recorder)


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
