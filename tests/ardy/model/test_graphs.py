"""Recorded layers: what is read and written when one is replayed, and that nothing changes."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.packed import PackedDenoiser
from motiongen_ardy.model.packed.graphs import SIZES, GraphedRows, GraphedStack, filled_size
from motiongen_ardy.model.packed.stack import Group
from motiongen_ardy.model.transformer import PositionTable
from tests.ardy.model.test_packed import GOLDEN, assert_equal
from tests.taped import TapeRecorder, eager

WIDTH = 4


def mixed(vectors: Tensor, groups: list[Group]) -> Tensor:
    """A stack whose every vector depends on all of its sequence, and on no other; what is read of it."""
    parts = [(group.of(vectors) + group.of(vectors).mean(dim=1, keepdim=True))[:, group.read] for group in groups]
    return torch.cat([part.reshape(-1, vectors.shape[-1]) for part in parts])


def groups_of(*shapes: tuple[int, int]) -> list[Group]:
    groups, start = [], 0
    for count, length in shapes:
        groups.append(Group(start, count, length, length // 3, length - length // 3))
        start = groups[-1].end
    return groups


def vectors_for(groups: list[Group], seed: int = 0) -> Tensor:
    return torch.randn(groups[-1].end, WIDTH, generator=torch.Generator().manual_seed(seed))


@settings(deadline=None, max_examples=30)
@given(st.lists(st.lists(st.tuples(st.integers(1, 70), st.integers(1, 6)), min_size=1, max_size=4), max_size=6))
def test_what_is_replayed_is_what_the_stack_gives(batches: list[list[tuple[int, int]]]) -> None:
    graphed = GraphedStack(mixed, eager(TapeRecorder(), most=3))
    for number, shapes in enumerate(batches):
        groups = groups_of(*shapes)
        vectors = vectors_for(groups, number)
        before = vectors.clone()
        assert torch.equal(graphed(vectors, groups), mixed(vectors, groups))
        assert torch.equal(vectors, before)


def test_a_shape_is_recorded_once_and_sizes_that_fill_up_alike_share_it() -> None:
    recorder = TapeRecorder()
    graphed = GraphedStack(mixed, eager(recorder))
    for count in (13, 14, 16, 13):
        groups = groups_of((count, 5))
        graphed(vectors_for(groups), groups)
    assert (recorder.num_recorded, recorder.num_replays) == (1, 4)
    groups = groups_of((13, 6))
    graphed(vectors_for(groups), groups)
    assert recorder.num_recorded == 2


def test_a_result_outlives_the_next_replay() -> None:
    graphed = GraphedStack(mixed, eager(TapeRecorder()))
    groups = groups_of((3, 5))
    first = graphed(vectors_for(groups, 1), groups)
    kept = first.clone()
    graphed(vectors_for(groups, 2), groups)
    assert torch.equal(first, kept)


def sums(values: Tensor, more: Tensor | None = None) -> tuple[Tensor, ...]:
    return values.sum(dim=1), values if more is None else values + more[:, None]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 5), st.booleans()), max_size=8))
def test_what_is_replayed_of_rows_is_what_the_function_gives(calls: list[tuple[int, int, bool]]) -> None:
    graphed = GraphedRows(sums, eager(TapeRecorder(), most=3))
    for count, length, has_more in calls:
        given = [torch.randn(count, length), *([torch.randn(count)] if has_more else [])]
        for found, expected in zip(graphed(*given), sums(*given), strict=True):
            assert torch.equal(found, expected)


def test_numbers_of_rows_that_fill_up_alike_share_a_graph_and_other_shapes_do_not() -> None:
    recorder = TapeRecorder()
    graphed = GraphedRows(sums, eager(recorder))
    for count in (13, 16, 14):
        graphed(torch.randn(count, 3))
    assert recorder.num_recorded == 1
    graphed(torch.randn(13, 4))
    graphed(torch.randn(13, 3), torch.randn(13))
    assert recorder.num_recorded == 3


def test_groups_that_come_together_in_other_ways_are_recorded_once_each() -> None:
    recorder = TapeRecorder()
    graphed = GraphedStack(mixed, eager(recorder))
    for shapes in ([(3, 5), (2, 7)], [(4, 5)], [(2, 7), (3, 5)], [(2, 7)]):
        groups = groups_of(*shapes)
        assert torch.equal(graphed(vectors_for(groups), groups), mixed(vectors_for(groups), groups))
    assert recorder.num_recorded == 2


@pytest.mark.parametrize("sequences", [1, 3, 17, 100, 512, 513, 2000])
def test_batches_are_filled_up_to_few_sizes_and_by_less_than_twice(sequences: int) -> None:
    filled = filled_size(sequences)
    assert sequences <= filled < 2 * sequences
    assert filled in SIZES or filled % SIZES[-1] == 0


def test_a_denoiser_with_recorded_layers_gives_what_the_plain_one_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    # Which the processor alone does: it need not wait for itself.
    monkeypatch.setattr(PositionTable, "checked", lambda table, positions: positions - table.lowest)
    model = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    recorder = TapeRecorder()
    with torch.no_grad():
        config = model.config
        packed = PackedDenoiser(model.denoiser, config.num_base_steps, config.horizon, torch.float32, eager(recorder))
        for shapes in ([(4, 0, False)], [(3, 0, False), (0, 0, False)], [(4, 3, True), (2, 0, True), (0, 1, True)]):
            assert_equal(model, packed, shapes, GuidanceWeights(2, 1.5), 1)
    # Groups of the batches, where passes that are not told the future are a shape of their own: of each a replay in
    # two steps, and one in both stages, whose layers are recorded by themselves, too.
    assert recorder.num_replays == (1 + 2 + 4) * (2 + 2)
