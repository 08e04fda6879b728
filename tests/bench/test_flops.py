"""The formulas for the FLOPs of a window, compared with what torch counts."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from tests.bench.flops import Pass, decode_flops, stack_flops, step_flops
from tests.bench.models import bench_model

TINY = bench_model("tiny").model


@pytest.mark.parametrize("sequence", [1, 17, 40])
def test_stack_flops_equal_what_torch_counts(sequence: int) -> None:
    stack = TINY.denoiser.root_model.seqTransEncoder
    vectors = torch.randn(1, sequence, TINY.config.denoiser.transformer.width)
    hidden = torch.zeros(1, sequence, dtype=torch.bool)
    with FlopCounterMode(display=False) as counted, torch.no_grad():
        stack(vectors, hidden)
    assert stack_flops(TINY.config.denoiser.transformer, sequence) == counted.get_total_flops()


def test_last_layer_costs_less_if_only_some_vectors_are_read() -> None:
    config = TINY.config.denoiser.transformer
    alone = replace(config, num_layers=1)
    assert stack_flops(config, 17, 17) == stack_flops(config, 17)
    saved = stack_flops(config, 17) - stack_flops(config, 17, 10)
    assert saved == stack_flops(alone, 17) - stack_flops(alone, 17, 10) > 0


def test_flops_grow_with_context_and_constraints() -> None:
    config, body = TINY.config, TINY.skeleton.feature_dim - 5
    short, long, constrained = (step_flops(config, one) for one in (Pass(0), Pass(4), Pass(4, 3)))
    assert short < long < constrained
    assert decode_flops(config, body, 0) < decode_flops(config, body, 4) < long
