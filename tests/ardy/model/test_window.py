from __future__ import annotations

from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from motiongen_ardy.model.window import Window, WindowError


def make_window(history: list[int], generation: list[int], num_frames: int, mask: Tensor | None = None) -> Window:
    rows = len(history)
    return Window(
        torch.tensor(history),
        torch.tensor(generation),
        num_frames,
        text=torch.ones(rows, 1, 2),
        heading=torch.zeros(rows),
        observed=mask,
        mask=mask,
    )


@pytest.mark.parametrize("case", ["with_constraints", "without_constraints"])
def test_masks_match_the_golden_vectors(golden: Any, case: str) -> None:
    vectors = golden.vectors("masks")
    mask = vectors["in.motion_mask"] if case == "with_constraints" else None
    window = make_window(
        vectors["in.history_len"].tolist(), vectors["in.generation_len"].tolist(), vectors.number("in.num_frames"), mask
    )
    vectors.check_equal("out.history_mask", window.history_frames)
    vectors.check_equal("out.generation_mask", window.generation_frames)
    vectors.check_equal("out.future_mask", window.future_frames)
    vectors.check_equal(f"out.{case}.history_token_mask", window.history_tokens)
    vectors.check_equal(f"out.{case}.generation_token_mask", window.generation_tokens)
    vectors.check_equal(f"out.{case}.future_token_mask", window.future_tokens)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.tuples(*[st.integers(0, 5)] * 3), min_size=1, max_size=4))
def test_every_frame_is_history_horizon_or_future(lengths: list[tuple[int, int, int]]) -> None:
    history, generation = [4 * row[0] for row in lengths], [4 * row[1] for row in lengths]
    num_frames = max(4, 4 * max(sum(row) for row in lengths))
    window = make_window(history, generation, num_frames)
    kinds = torch.stack([window.history_frames, window.generation_frames, window.future_frames]).int()
    assert torch.equal(kinds.sum(0), torch.ones(len(lengths), num_frames, dtype=torch.int32))
    assert window.history_frames.sum(1).tolist() == history
    assert window.generation_frames.sum(1).tolist() == generation
    assert not (window.history_tokens & window.generation_tokens).any()
    assert window.generation_tokens.sum(1).tolist() == [frames // 4 for frames in generation]


def test_positions_count_from_the_first_generated_token() -> None:
    window = make_window([0, 8], [8, 8], 20)
    assert window.token_positions.tolist() == [[0, 1, 2, 3, 4], [-2, -1, 0, 1, 2]]


def test_only_constrained_future_tokens_are_visible() -> None:
    mask = torch.zeros(1, 20, 3)
    mask[0, 2] = mask[0, 6] = mask[0, 17, 1] = 1  # history, horizon and the last future token
    window = make_window([4], [8], 20, mask)
    assert window.future_tokens.tolist() == [[False, False, False, False, True]]


def test_removing_text_or_constraints_leaves_the_rest() -> None:
    window = make_window([4], [8], 16, torch.ones(1, 16, 3))
    silent = window.without_text()
    assert not silent.text.any()
    assert silent.mask is window.mask
    free = window.without_constraints()
    assert free.mask is None
    assert free.observed is None
    assert not free.future_tokens.any()
    assert window.future_tokens.any()
    assert free.text is window.text


def test_a_window_that_is_not_whole_tokens_is_refused() -> None:
    with pytest.raises(WindowError, match="has 18 frames"):
        make_window([4], [8], 18)


def test_observed_without_mask_is_refused() -> None:
    window = make_window([4], [8], 16)
    with pytest.raises(WindowError, match="go together"):
        Window(window.history_len, window.generation_len, 16, window.text, window.heading, torch.zeros(1, 16, 3))
