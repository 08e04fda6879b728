"""The layers' kernels on a CUDA device compared with torch's, and a sequence in a batch compared with itself alone."""

from __future__ import annotations

import pytest
import torch

from motiongen_ardy.model.config import TransformerConfig
from motiongen_ardy.model.packed.stack import Group, PackedStack
from motiongen_ardy.model.transformer import TransformerStack

pytestmark = pytest.mark.gpu
GROUPS = [Group(0, 40, 17, 7, 10), Group(680, 3, 33, 7, 10), Group(779, 2, 64, 20, 44)]


def stack_of(width: int, heads: int, norm_first: bool) -> PackedStack:
    torch.manual_seed(3)
    plain = TransformerStack(TransformerConfig(width, 2 * width, 4, heads, "gelu", norm_first))
    return PackedStack(plain.to("cuda").requires_grad_(False), torch.bfloat16)


@pytest.mark.parametrize(("width", "heads"), [(1024, 8), (256, 4)])
@pytest.mark.parametrize("norm_first", [False, True])
@torch.inference_mode()
def test_layers_with_kernels_match_those_without(width: int, heads: int, norm_first: bool) -> None:
    stack = stack_of(width, heads, norm_first)
    assert stack._fused is not None, "Triton cannot compile kernels here"
    vectors = torch.randn(GROUPS[-1].end, width, device="cuda")
    found = stack(vectors, GROUPS)
    stack._fused = None
    expected = stack(vectors, GROUPS)
    # Both round to bfloat16 eight times a layer, at different places of their sums.
    assert (found - expected).norm() < 0.01 * expected.norm()


@torch.inference_mode()
def test_attention_of_a_sequence_is_the_same_in_any_batch() -> None:
    stack = stack_of(1024, 8, False)
    assert stack._fused is not None
    layer, kernels = stack.layers[0], stack._fused._kernels
    packed = torch.randn(GROUPS[-1].end, 3 * 1024, device="cuda", dtype=torch.bfloat16)

    def attended(values: torch.Tensor, sequences: int) -> torch.Tensor:
        taken = values.new_empty(sequences * 17, 1024)
        sizes = {"HEADS": layer.num_heads, "WIDTH": 128, "KEYS": 32, "QUERIES": 32}
        kernels.attend[(sequences, layer.num_heads)](values, taken, 0, 17, 0, 17, 0, 128**-0.5, **sizes)
        return taken

    together = attended(packed, 40)
    for number in (0, 7, 39):
        alone = attended(packed[17 * number : 17 * (number + 1)].contiguous(), 1)
        assert torch.equal(together[17 * number : 17 * (number + 1)], alone)
