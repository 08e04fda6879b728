"""Which shapes are recorded, which graphs stay, and which go."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from motiongen_ardy.model.packed.graph_cache import Graph, GraphCache
from tests.taped import TapeRecorder


def begin(num_floats: int) -> Callable[[], tuple[list[Tensor], Callable[[], Tensor]]]:
    def begun() -> tuple[list[Tensor], Callable[[], Tensor]]:
        read_from = torch.zeros(num_floats)
        return [read_from], lambda: read_from + 1

    return begun


def come(graphs: GraphCache, *keys: str, num_floats: int = 1) -> list[Graph[Tensor] | None]:
    return [graphs.of(key, begin(num_floats)) for key in keys]


def test_a_shape_is_recorded_once_it_has_come_often() -> None:
    recorder = TapeRecorder()
    graphs = GraphCache(recorder, worth_it=3)
    assert come(graphs, "a", "b", "a") == [None, None, None]
    [graph] = come(graphs, "a")
    assert graph is not None
    assert come(graphs, "a", "b") == [graph, None]
    assert recorder.num_recorded == graphs.num_recorded == 1


def test_what_was_not_replayed_for_longest_goes_first() -> None:
    graphs = GraphCache(TapeRecorder(), most=2, worth_it=1)
    a, b, again, _, kept = come(graphs, "a", "b", "a", "c", "a")
    assert a is again is kept
    assert come(graphs, "b") != [b]


def test_they_are_as_few_as_what_they_read_makes_them() -> None:
    graphs = GraphCache(TapeRecorder(), most_bytes=4 * 250, worth_it=1)
    [first] = come(graphs, "a", num_floats=100)
    assert come(graphs, "b", "a", num_floats=100)[1] is first
    come(graphs, "c", num_floats=100)  # b goes
    assert come(graphs, "a", num_floats=100) == [first]
    [large] = come(graphs, "d", num_floats=1000)
    assert come(graphs, "d", num_floats=1000) == [large], "one alone may be larger"
    assert come(graphs, "a", num_floats=100) != [first]


def test_what_is_recorded_at_once_stays() -> None:
    graphs = GraphCache(TapeRecorder(), most=1, worth_it=2)
    with graphs.at_once():
        usual = come(graphs, "a", "b", "c")
    come(graphs, "d", "d", "e", "e")
    assert None not in usual
    assert come(graphs, "a", "b", "c") == usual


def test_it_ends_with_an_error() -> None:
    graphs = GraphCache(TapeRecorder(), worth_it=2)
    with pytest.raises(ValueError, match="no"), graphs.at_once():
        raise ValueError("no")
    assert come(graphs, "a") == [None]


def test_all_may_be_let_go() -> None:
    graphs = GraphCache(TapeRecorder(), worth_it=2)
    with graphs.at_once():
        come(graphs, "a")
    come(graphs, "b", "b")
    graphs.clear()
    assert come(graphs, "a", "b") == [None, None]
