"""The layers for constraints: few columns for the root alone, all for others, and the same result in any batch."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from motiongen_ardy.core.representation import ROOT_WIDTH
from motiongen_ardy.model.packed.goal_layers import GoalLayer, TokenGoals

PATCH, FEATURES, WIDTH = 4, 30, 12
ROOT = ROOT_WIDTH * PATCH


def goals(beyond: list[bool]) -> tuple[TokenGoals, Tensor, Tensor]:
    """Random constraints of some tokens, on the root alone where not `beyond`; and their values and mask."""
    draw = torch.Generator().manual_seed(3)
    mask = (torch.rand(len(beyond), PATCH, FEATURES, generator=draw) < 0.5).float()
    mask[~torch.tensor(beyond), :, ROOT_WIDTH:] = 0
    observed = torch.randn(len(beyond), PATCH, FEATURES, generator=draw) * mask
    return TokenGoals.of(observed, mask, (mask[..., ROOT_WIDTH:] != 0).flatten(1).any(dim=1)), observed, mask


@pytest.mark.parametrize("reads_root", [True, False])
def test_the_sum_equals_that_over_all_columns(reads_root: bool) -> None:
    told, observed, mask = goals([False, True, False])
    parts = [observed[..., :ROOT_WIDTH].flatten(1)] if reads_root else []
    inputs = torch.cat([*parts, observed[..., ROOT_WIDTH:].flatten(1), mask.flatten(1)], dim=1)
    draw = torch.Generator().manual_seed(4)
    weight, bias = torch.randn(WIDTH, inputs.shape[1], generator=draw), torch.randn(WIDTH, generator=draw)
    found = GoalLayer(weight, bias, PATCH, reads_root=reads_root)(told)
    torch.testing.assert_close(found, inputs @ weight.T + bias, atol=1e-4, rtol=1e-5)
    assert told.beyond_root.tolist() == [False, True, False]


def test_the_result_of_a_token_does_not_depend_on_its_batch() -> None:
    told, _, _ = goals([False, True, False, False])
    weight = torch.randn(WIDTH, ROOT + 2 * PATCH * FEATURES - ROOT, generator=torch.Generator().manual_seed(5))
    layer = GoalLayer(weight, torch.zeros(WIDTH), PATCH, reads_root=True)
    together = layer(told)
    for index in range(4):
        assert torch.equal(layer(told.between(index, index + 1))[0], together[index])


def test_an_empty_batch_of_tokens_gives_an_empty_result() -> None:
    told, _, _ = goals([False])
    layer = GoalLayer(torch.randn(WIDTH, 2 * PATCH * FEATURES - ROOT), torch.zeros(WIDTH), PATCH, reads_root=False)
    assert layer(told.between(0, 0)).shape == (0, WIDTH)
