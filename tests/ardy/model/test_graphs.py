"""Replayed graphs: what they read and write, and the same results as without them."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.model.denoiser.guidance import GuidanceWeights
from motiongen_ardy.model.packed import PackedDenoiser
from motiongen_ardy.model.packed.graphs import SIZES, GraphedRows, filled_size
from motiongen_ardy.model.transformer import PositionTable
from tests.ardy.model.test_packed import GOLDEN, assert_equal
from tests.taped import TapeRecorder, eager


def sums(values: Tensor, more: Tensor | None = None) -> tuple[Tensor, ...]:
    return values.sum(dim=1), values if more is None else values + more[:, None]


@settings(deadline=None, max_examples=30)
@given(st.lists(st.tuples(st.integers(1, 40), st.integers(1, 5), st.booleans()), max_size=8))
def test_replayed_graphs_give_the_results_of_the_function(calls: list[tuple[int, int, bool]]) -> None:
    graphed = GraphedRows(sums, eager(TapeRecorder(), most=3))
    for count, length, has_more in calls:
        given = [torch.randn(count, length), *([torch.randn(count)] if has_more else [])]
        for found, expected in zip(graphed(*given), sums(*given), strict=True):
            assert torch.equal(found, expected)


def test_row_counts_padded_to_one_size_share_a_graph_and_other_shapes_do_not() -> None:
    recorder = TapeRecorder()
    graphed = GraphedRows(sums, eager(recorder))
    for count in (13, 16, 14):
        graphed(torch.randn(count, 3))
    assert recorder.num_recorded == 1
    graphed(torch.randn(13, 4))
    graphed(torch.randn(13, 3), torch.randn(13))
    assert recorder.num_recorded == 3


@pytest.mark.parametrize("rows", [1, 3, 17, 100, 512, 513, 2000])
def test_batches_are_padded_to_few_sizes_and_less_than_doubled(rows: int) -> None:
    filled = filled_size(rows)
    assert rows <= filled < 2 * rows
    assert filled in SIZES or filled % SIZES[-1] == 0


def test_a_denoiser_with_recorded_layers_equals_the_plain_one(monkeypatch: pytest.MonkeyPatch) -> None:
    # Only a CPU checks positions, since it need not wait for itself.
    monkeypatch.setattr(PositionTable, "checked", lambda table, positions: positions - table.lowest)
    model = load_checkpoint(GOLDEN / "tiny-core27" / "checkpoint")
    recorder = TapeRecorder()
    with torch.no_grad():
        config = model.config
        packed = PackedDenoiser(model.denoiser, config.num_base_steps, config.horizon, torch.float32, eager(recorder))
        for shapes in ([(4, 0, False)], [(3, 0, False), (0, 0, False)], [(4, 3, True), (2, 0, True), (0, 1, True)]):
            assert_equal(model, packed, shapes, GuidanceWeights(2, 1.5), 1)
    # One replay for each group of a batch and each of two steps; passes without the future are a group of their own.
    assert recorder.num_replays == (1 + 2 + 4) * 2
