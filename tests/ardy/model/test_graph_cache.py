"""The cache of graphs: which shapes are recorded, which graphs are kept, and which are dropped."""

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


def request(graphs: GraphCache, *keys: str, num_floats: int = 1) -> list[Graph[Tensor] | None]:
    return [graphs.of(key, begin(num_floats)) for key in keys]


def test_a_shape_is_recorded_once_it_was_requested_often_enough() -> None:
    recorder = TapeRecorder()
    graphs = GraphCache(recorder, worth_it=3)
    assert request(graphs, "a", "b", "a") == [None, None, None]
    [graph] = request(graphs, "a")
    assert graph is not None
    assert request(graphs, "a", "b") == [graph, None]
    assert recorder.num_recorded == graphs.num_recorded == 1


def test_the_least_recently_replayed_graph_is_dropped_first() -> None:
    graphs = GraphCache(TapeRecorder(), most=2, worth_it=1)
    a, b, again, _, kept = request(graphs, "a", "b", "a", "c", "a")
    assert a is again is kept
    assert request(graphs, "b") != [b]


def test_graphs_are_dropped_when_their_inputs_take_too_much_memory() -> None:
    graphs = GraphCache(TapeRecorder(), most_bytes=4 * 250, worth_it=1)
    [first] = request(graphs, "a", num_floats=100)
    assert request(graphs, "b", "a", num_floats=100)[1] is first
    request(graphs, "c", num_floats=100)  # b is dropped
    assert request(graphs, "a", num_floats=100) == [first]
    [large] = request(graphs, "d", num_floats=1000)
    assert request(graphs, "d", num_floats=1000) == [large], "a single graph may be larger"
    assert request(graphs, "a", num_floats=100) != [first]


def test_graphs_recorded_at_once_are_not_dropped() -> None:
    graphs = GraphCache(TapeRecorder(), most=1, worth_it=2)
    with graphs.at_once():
        usual = request(graphs, "a", "b", "c")
    request(graphs, "d", "d", "e", "e")
    assert None not in usual
    assert request(graphs, "a", "b", "c") == usual


def test_an_error_ends_recording_at_once() -> None:
    graphs = GraphCache(TapeRecorder(), worth_it=2)
    with pytest.raises(ValueError, match="no"), graphs.at_once():
        raise ValueError("no")
    assert request(graphs, "a") == [None]


def test_clear_drops_all_graphs() -> None:
    graphs = GraphCache(TapeRecorder(), worth_it=2)
    with graphs.at_once():
        request(graphs, "a")
    request(graphs, "b", "b")
    graphs.clear()
    assert request(graphs, "a", "b") == [None, None]
