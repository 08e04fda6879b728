"""Layers with kernels between their products give what layers without them give.

Triton interprets the kernels on the processor.
"""

from __future__ import annotations

import importlib.util
import logging
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest
import torch

from motiongen_ardy.model.config import TransformerConfig
from motiongen_ardy.model.packed import fused
from motiongen_ardy.model.packed.fused import FusedStack, fused_stack
from motiongen_ardy.model.packed.stack import Group, PackedStack
from motiongen_ardy.model.transformer import TransformerStack

WIDTH, HEADS = 64, 4


@pytest.fixture(scope="module")
def kernels() -> Iterator[ModuleType]:
    """The kernels as Triton's interpreter runs them, which it decides when they are defined."""
    path = Path(fused.__file__).with_name("kernels.py")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TRITON_INTERPRET", "1")
        spec = importlib.util.spec_from_file_location("interpreted_kernels", path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module


def stack_of(norm_first: bool, activation: str = "gelu") -> PackedStack:
    torch.manual_seed(3)
    plain = TransformerStack(TransformerConfig(WIDTH, 96, 3, HEADS, activation, norm_first))
    for parameter in plain.parameters():
        parameter.data += 0.05 * torch.randn_like(parameter)
    return PackedStack(plain.requires_grad_(False), torch.float32)  # the interpreter knows no products of bfloat16


def groups_of(*shapes: tuple[int, int, int, int]) -> list[Group]:
    """shapes: sequences, their length, and first and number of what is read."""
    groups, start = [], 0
    for count, length, first_read, num_read in shapes:
        groups.append(Group(start, count, length, first_read, num_read))
        start = groups[-1].end
    return groups


@pytest.mark.parametrize("norm_first", [False, True])
@pytest.mark.parametrize("activation", ["gelu", "relu"])
@torch.inference_mode()
def test_fused_layers_give_what_plain_ones_give(kernels: ModuleType, norm_first: bool, activation: str) -> None:
    stack = stack_of(norm_first, activation)
    groups = groups_of((3, 17, 7, 10), (1, 40, 3, 37), (2, 5, 4, 1))
    vectors = torch.randn(groups[-1].end + 4, WIDTH)  # some more behind the last, that nobody looks at
    expected = stack(vectors, groups)
    found = FusedStack(stack.layers, kernels)(vectors, groups)
    assert found.shape == expected.shape
    assert found.dtype == torch.float32
    assert torch.allclose(found, expected, atol=2e-5)


@torch.inference_mode()
def test_sums_and_norms_are_rounded_once_at_their_end(kernels: ModuleType) -> None:
    product, stream = torch.randn(5, 96).bfloat16(), torch.randn(5, 96)
    weight, bias = torch.randn(96), torch.randn(96)
    for norm_added in (False, True):
        added, normed = torch.empty_like(stream), torch.empty_like(product)
        sizes = {"WIDTH": 96, "BLOCK": 128, "NORM_ADDED": norm_added}
        kernels.add_and_norm[(5,)](product, stream, weight, bias, added, normed, 1e-5, **sizes)
        total = stream + product.float()
        norm = torch.layer_norm(total, (96,), weight, bias, 1e-5)
        assert torch.allclose(added, norm if norm_added else total, atol=1e-5)
        assert torch.allclose(normed.float(), norm, rtol=2**-7, atol=1e-5)  # the interpreter cuts off, a GPU rounds


@torch.inference_mode()
def test_a_sequence_gets_from_the_kernels_what_it_gets_alone(kernels: ModuleType) -> None:
    stack = stack_of(False)
    fused_layers = FusedStack(stack.layers, kernels)
    groups = groups_of((4, 17, 7, 10), (2, 5, 1, 4))
    vectors = torch.randn(groups[-1].end, WIDTH)
    together = fused_layers(vectors, groups)
    alone = fused_layers(vectors[17:34], groups_of((1, 17, 7, 10)))
    assert torch.equal(together[10:20], alone)


def test_processors_are_left_to_torch() -> None:
    assert fused_stack(stack_of(False).layers) is None


def test_a_machine_without_a_compiler_is_warned_of_and_served(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "motiongen_ardy.model.packed.kernels", None)
    with caplog.at_level(logging.WARNING):
        assert fused._compiled.__wrapped__(torch.device("cpu")) is None
    assert "which takes longer" in caplog.text
