"""GraphCache: the recorded graphs of one runner, of all kinds of work, and when a shape is worth one."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from torch import Tensor

MOST_GRAPHS = 128
MOST_BYTES = 1 << 30
"""Of what graphs read. Beyond either those go that were not replayed for longest."""
WORTH_IT = 8
"""Recording takes some 25 ms, and replaying saves 2 to 18 each time (docs/performance/gpu.md)."""
_MOST_COUNTED = 4096

Result = TypeVar("Result")


class GraphRecorder(Protocol):
    """Makes work that can be replayed."""

    def record(self, work: Callable[[], Result]) -> tuple[Callable[[], None], Result]:
        """What does the work again, on the memory it was recorded with, and the tensors that it leaves its result in.

        Results of two recordings may share memory: each is to be taken before the next replay.
        """
        ...


class RecordingFailed(RuntimeError):
    """Work could not be recorded; the device may not be used any more."""


@dataclass(frozen=True, slots=True, eq=False)
class Graph(Generic[Result]):
    """read_from: what is written before it is replayed; result: what is read after."""

    read_from: Sequence[Tensor]
    replay: Callable[[], None]
    result: Result

    @property
    def num_bytes(self) -> int:
        return sum(part.nbytes for part in self.read_from)


class GraphCache:
    """Graphs by what they were recorded for. num_recorded: how many were made in all.

    A shape is recorded once it has come so often that it is worth it: what clients ask for has shapes without end, and
    everybody waits while one is recorded. Those that are recorded at once, before anybody waits, stay.
    """

    def __init__(
        self,
        recorder: GraphRecorder,
        most: int = MOST_GRAPHS,
        most_bytes: int = MOST_BYTES,
        worth_it: int = WORTH_IT,
    ) -> None:
        """most, most_bytes: of graphs that were not recorded at once. worth_it: a shape that comes so many times."""
        self._recorder, self._most, self._most_bytes, self._worth_it = recorder, most, most_bytes, worth_it
        self._staying: dict[Hashable, Graph[Any]] = {}
        self._others: OrderedDict[Hashable, Graph[Any]] = OrderedDict()
        self._others_bytes = 0
        self._came: OrderedDict[Hashable, int] = OrderedDict()
        self._is_at_once = False
        self.num_recorded = 0

    @contextmanager
    def at_once(self) -> Iterator[None]:
        """Within, every shape is recorded when it first comes, and stays."""
        self._is_at_once = True
        try:
            yield
        finally:
            self._is_at_once = False

    def of(
        self, key: Hashable, begin: Callable[[], tuple[Sequence[Tensor], Callable[[], Result]]]
    ) -> Graph[Result] | None:
        """The graph for a key, None while it is not worth one.

        begin: what a graph is to read, and the work that reads it; the same for every call with this key.
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
        """Let go of all graphs, and so of their memory."""
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
