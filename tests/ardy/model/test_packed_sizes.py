"""The number of kernels that products of all sizes need; each is made once and takes memory."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from motiongen_ardy.model.packed.linear import filled_size

MOST = 300
PRODUCTS = f"""
import torch
from torch import nn
from motiongen_ardy.model.packed.linear import PackedLinear
layer = PackedLinear.of(nn.Linear(24, 40), torch.float32)
print("packed" if layer.onednn else "without oneDNN", flush=True)
for count in range(1, {MOST} + 1):
    values, addend = torch.ones(count, 24), torch.ones(count, 40)
    assert layer(values).shape == layer.plus(values, addend).shape == (count, 40)
"""


def test_padded_sizes_are_few_and_waste_little() -> None:
    filled = [filled_size(count) for count in range(1, 4097)]
    assert filled == sorted(filled)
    assert all(filled_size(size) == size for size in filled)
    assert len(set(filled)) < 40
    assert all(count <= size for count, size in enumerate(filled, 1))
    assert all(size < 1.25 * count for count, size in enumerate(filled, 1) if count > 16)
    assert sum(filled) < 1.12 * sum(range(1, 4097))


def test_a_kernel_serves_many_sizes() -> None:
    """Counted in the log that oneDNN keeps of the kernels that it makes."""
    environment = {**os.environ, "ONEDNN_VERBOSE": "profile_create", "ONEDNN_PRIMITIVE_CACHE_CAPACITY": "1024"}
    done = subprocess.run([sys.executable, "-c", PRODUCTS], env=environment, capture_output=True, text=True, check=True)
    if "without oneDNN" in done.stdout:
        pytest.skip("no oneDNN on this processor")
    _, served = done.stdout.split("packed\n")
    made = [line for line in served.splitlines() if "create:cache_miss" in line and "inner_product" in line]
    sizes = {filled_size(count) for count in range(1, MOST + 1)}
    assert 0 < len(made) <= 2 * len(sizes), "one for products alone, one for products with an addend"
