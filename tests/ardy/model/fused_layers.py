"""Layers with fused kernels between their matrix products, against plain layers; Triton interprets the kernels.

`test_fused.py` runs this in a separate process, because Triton decides whether to interpret when it is first imported.
"""

from __future__ import annotations

from types import ModuleType

import pytest
import torch

from motiongen_ardy.model.config import TransformerConfig
from motiongen_ardy.model.packed.fused import FusedStack
from motiongen_ardy.model.packed.stack import Group, PackedStack
from motiongen_ardy.model.transformer import TransformerStack

WIDTH, HEADS = 64, 4


@pytest.fixture(scope="module")
def kernels() -> ModuleType:
    from motiongen_ardy.model.packed import kernels

    return kernels


def stack_of(norm_first: bool, activation: str = "gelu") -> PackedStack:
    torch.manual_seed(3)
    plain = TransformerStack(TransformerConfig(WIDTH, 96, 3, HEADS, activation, norm_first))
    for parameter in plain.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    return PackedStack(plain.requires_grad_(False), torch.float32)  # the interpreter has no bfloat16 products


def groups_of(*shapes: tuple[int, int, int, int]) -> list[Group]:
    """shapes: number of sequences, their length, and the first position and the number of positions that are read."""
    groups, start = [], 0
    for count, length, first_read, num_read in shapes:
        groups.append(Group(start, count, length, first_read, num_read))
        start = groups[-1].end
    return groups


@pytest.mark.parametrize("norm_first", [False, True])
@pytest.mark.parametrize("activation", ["gelu", "relu"])
@torch.inference_mode()
def test_fused_layers_equal_plain_layers(kernels: ModuleType, norm_first: bool, activation: str) -> None:
    stack = stack_of(norm_first, activation)
    groups = groups_of((3, 17, 7, 10), (1, 40, 3, 37), (2, 5, 4, 1))
    vectors = torch.randn(groups[-1].end + 4, WIDTH)  # some more after the last, which must be ignored
    expected = stack(vectors, groups)
    found = FusedStack(stack.layers, kernels)(vectors, groups)
    assert found.shape == expected.shape
    assert found.dtype == torch.float32
    assert torch.allclose(found, expected, atol=2e-5)


@torch.inference_mode()
def test_add_and_norm_matches_the_float32_computation(kernels: ModuleType) -> None:
    product, stream = torch.randn(5, 96).bfloat16(), torch.randn(5, 96)
    weight, bias = torch.randn(96), torch.randn(96)
    for norm_added in (False, True):
        added, normed = torch.empty_like(stream), torch.empty_like(product)
        sizes = {"WIDTH": 96, "BLOCK": 128, "NORM_ADDED": norm_added}
        kernels.add_and_norm[(5,)](product, stream, weight, bias, added, normed, 1e-5, **sizes)
        total = stream + product.float()
        norm = torch.layer_norm(total, (96,), weight, bias, 1e-5)
        assert torch.allclose(added, norm if norm_added else total, atol=1e-5)
        assert torch.allclose(normed.float(), norm, rtol=2**-7, atol=1e-5)  # the interpreter truncates, a GPU rounds


@torch.inference_mode()
def test_the_result_of_a_sequence_does_not_depend_on_its_batch(kernels: ModuleType) -> None:
    stack = stack_of(False)
    fused_layers = FusedStack(stack.layers, kernels)
    groups = groups_of((4, 17, 7, 10), (2, 5, 1, 4))
    vectors = torch.randn(groups[-1].end, WIDTH)
    together = fused_layers(vectors, groups)
    alone = fused_layers(vectors[17:34], groups_of((1, 17, 7, 10)))
    assert torch.equal(together[10:20], alone)
