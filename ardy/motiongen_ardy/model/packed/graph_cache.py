"""GraphCache: all recorded graphs of one runner, and the decision when a shape is worth recording."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from torch import Tensor

MOST_GRAPHS = 128
MOST_BYTES = 1 << 30
"""The most memory that graphs read. Above MOST_GRAPHS or MOST_BYTES, those least recently replayed are dropped."""
WORTH_IT = 8
"""Occurrences before a shape is recorded: that takes some 25 ms, and a replay saves 2 to 18
(docs/performance/gpu.md).
"""
_MOST_COUNTED = 4096

Result = TypeVar("Result")


class GraphRecorder(Protocol):
    """Records work so that it can be replayed."""

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        """A function that repeats the work on the memory it was recorded with, and the tensors that receive its result.

        The results of two recordings may share memory: read each one before the next replay.
        """
        ...


class RecordingFailed(RuntimeError):
    """Work could not be recorded; the device may no longer be usable."""


@dataclass(frozen=True, slots=True, eq=False)
class Graph(Generic[Result]):
    """read_from: tensors to write to before a replay; result: what to read after it."""

    read_from: Sequence[Tensor]
    replay: Callable[[], None]
    result: Result

    @property
    def num_bytes(self) -> int:
        return sum(part.nbytes for part in self.read_from)


class GraphCache:
    """Graphs by key. num_recorded: how many have been recorded in all.

    A shape is recorded only once it has occurred often enough: clients can cause any number of shapes, and all sessions
    wait during a recording. Graphs that were recorded within `at_once`, before there are sessions, are never evicted.
    """

    def __init__(
        self,
        recorder: GraphRecorder,
        most: int = MOST_GRAPHS,
        most_bytes: int = MOST_BYTES,
        worth_it: int = WORTH_IT,
    ) -> None:
        """most, most_bytes: limits for graphs recorded outside `at_once`. worth_it: occurrences before recording."""
        self._recorder, self._most, self._most_bytes, self._worth_it = recorder, most, most_bytes, worth_it
        self._staying: dict[Hashable, Graph[Any]] = {}
        self._others: OrderedDict[Hashable, Graph[Any]] = OrderedDict()
        self._others_bytes = 0
        self._came: OrderedDict[Hashable, int] = OrderedDict()
        self._is_at_once = False
        self.num_recorded = 0

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Within this context, every shape is recorded on its first occurrence and never evicted."""
        self._is_at_once = True
        try:
            yield
        finally:
            self._is_at_once = False

    def of(
        self, key: Hashable, begin: Callable[[], tuple[Sequence[Tensor], Callable[[], Result]]]
    ) -> Graph[Result] | None:
        """The graph for a key, or None while the key is not worth recording.

        begin: returns the tensors that a graph reads, and the work that reads them; the same for every call with this
        key.
        """
        held = self._staying.get(key) or self._others.get(key)
        if held is None:
            if not self._is_worth_it(key):
                return None
            held = self._record(*begin())
            self._keep(key, held)
        elif key in self._others:
            self._others.move_to_end(key)
        return held

    def clear(self) -> None:
        """Drop all graphs, and so free their memory."""
        self._staying.clear()
        self._others.clear()
        self._came.clear()
        self._others_bytes = 0

    def _is_worth_it(self, key: Hashable) -> bool:
        if self._is_at_once:
            return True
        came = self._came.pop(key, 0) + 1
        if came >= self._worth_it:
            return True
        self._came[key] = came
        if len(self._came) > _MOST_COUNTED:
            self._came.popitem(last=False)
        return False

    def _record(self, read_from: Sequence[Tensor], work: Callable[[], Result]) -> Graph[Result]:
        graph = Graph(read_from, *self._recorder.record(work))
        self.num_recorded += 1
        return graph

    def _keep(self, key: Hashable, graph: Graph[Any]) -> None:
        if self._is_at_once:
            self._staying[key] = graph
            return
        self._others[key] = graph
        self._others_bytes += graph.num_bytes
        while len(self._others) > 1 and (len(self._others) > self._most or self._others_bytes > self._most_bytes):
            _, gone = self._others.popitem(last=False)
            self._others_bytes -= gone.num_bytes
