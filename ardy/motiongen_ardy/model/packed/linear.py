"""A linear layer for inference: its weight is laid out once, and what follows the product is fused into it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import torch
from torch import Tensor, nn
from torch.nn import functional

# Kernels for few vectors may add in another order than those for many; from this many on there is only one order.
_MANY = {torch.float32: 256, torch.bfloat16: 768}
# Up to _FEW vectors, counts are rounded up to a power of two; above, to one of so many counts per doubling.
_FEW, _SIZES_A_DOUBLING = 16, 4

Activation = Callable[[Tensor], Tensor]

# On a CPU, these oneDNN operators take a weight in the kernel's own layout, whereas `functional.linear` converts it at
# every call, and they apply the activation or add the residual while the result is still in registers.
_POINTWISE: dict[Activation | None, str] = {None: "none", functional.gelu: "gelu", functional.relu: "relu"}


def _onednn_takes(weight: Tensor) -> bool:
    if weight.device.type != "cpu" or not torch.backends.mkldnn.is_available():
        return False
    operators = torch.ops.mkldnn
    if not all(hasattr(operators, name) for name in ("_reorder_linear_weight", "_linear_pointwise")):
        return False
    return weight.dtype == torch.float32 or bool(torch.ops.mkldnn._is_mkldnn_bf16_supported())


def filled_size(vectors: int) -> int:
    """The number of vectors to which `vectors` are padded, where each number has its own kernel.

    oneDNN compiles a kernel for each number of vectors and each matrix, which takes longer than a small product, and
    keeps few of them (`docs/performance/memory.md`). Batches come in hundreds of sizes, so nearly every step would
    compile kernels. With padding, at most a quarter is computed in vain, a tenth on average.
    """
    if vectors <= _FEW:
        return 1 << max(vectors - 1, 0).bit_length()
    step = max(1 << (vectors - 1).bit_length() - 1, _FEW) // _SIZES_A_DOUBLING
    return -(-vectors // step) * step


def least_agreeing(product: Callable[[int], Tensor], sizes: Sequence[int]) -> int:
    """The smallest size from which on all sizes give their vectors the same results as the largest one.

    product: n -> (n, out), the product of the first n of some vectors. sizes: ascending.
    """
    among_most, least = product(sizes[-1]), sizes[-1]
    for size in reversed(sizes):
        if not torch.equal(product(size), among_most[:size]):
            break
        least = size
    return least


@lru_cache(maxsize=256)
@torch.inference_mode()
def _least_vectors(outputs: int, inputs: int, dtype: torch.dtype) -> int:
    """From how many vectors on the kernels for a matrix (outputs, inputs) add in the same order.

    With AMX and bfloat16, those for 512 by 256 do so from 256 vectors on; from 48 to 224 they use another order. The
    test vectors make the second half of each sum cancel the first, so that only rounding errors remain, which reveal
    the order. With ordinary vectors, rounded to bfloat16, one number in many thousands would show it.
    """
    many, random, half = _MANY[dtype], torch.Generator().manual_seed(0), -(-inputs // 2)
    rows, columns = torch.randn(many, half, generator=random), torch.randn(outputs, half, generator=random)
    values = torch.cat([rows, -rows], dim=1)[:, :inputs].to(dtype)
    weight = torch.cat([columns, columns], dim=1)[:, :inputs].to(dtype).contiguous()
    weight, bias = torch.ops.mkldnn._reorder_linear_weight(weight), torch.zeros(outputs, dtype=dtype)
    operator = torch.ops.mkldnn._linear_pointwise
    return least_agreeing(
        lambda count: operator(values[:count], weight, bias, "none", [], "none"),
        sorted({filled_size(count) for count in range(1, many + 1)}),
    )


class PackedLinear:
    """x W^T + b in the precision of a copied weight, with an optional activation or an optional addend.

    least_vectors: inputs with fewer vectors are padded to this number, so that a vector's result does not depend on how
    many there are; larger inputs are padded to `filled_size`.
    """

    def __init__(self, weight: Tensor, bias: Tensor, dtype: torch.dtype, activation: Activation | None = None) -> None:
        """weight: (out, in). Raises ValueError for an activation other than gelu and relu."""
        if activation not in _POINTWISE:
            raise ValueError(f"activation is {activation}; it must be gelu, relu or None")
        self._activation = activation
        self._weight = weight.detach().to(dtype).contiguous().clone()
        self._bias = bias.detach().to(dtype).clone()
        self.onednn = _onednn_takes(self._weight)
        self.least_vectors = 1
        if self.onednn:
            self._weight = torch.ops.mkldnn._reorder_linear_weight(self._weight)
            self._operator = torch.ops.mkldnn._linear_pointwise.default
            self.least_vectors = _least_vectors(*weight.shape, dtype)

    @classmethod
    def of(cls, layer: nn.Linear, dtype: torch.dtype, activation: Activation | None = None) -> PackedLinear:
        """From a torch layer."""
        return cls(layer.weight, layer.bias, dtype, activation)

    def __call__(self, values: Tensor) -> Tensor:
        """values: (..., in) in the layer's precision."""
        return self._product(values, self._activation)

    def plus(self, values: Tensor, addend: Tensor) -> Tensor:
        """The result for values (..., in), without activation, plus an addend (..., out), in the addend's precision.

        A float32 addend is added in float32 even if the product is in another precision.
        """
        if addend.dtype != self._weight.dtype or not self.onednn or self._missing(values):
            # Converted, then added in place: a sum of two precisions takes up to twice as long.
            return self._product(values, None).to(addend.dtype).add_(addend)
        operators = torch.ops.mkldnn._linear_pointwise
        result: Tensor = operators.binary(values, addend, self._weight, self._bias, "add")
        return result

    def _missing(self, values: Tensor) -> int:
        """How many vectors of padding the product needs."""
        count = values.shape[:-1].numel()
        return max(filled_size(count) if self.onednn else count, self.least_vectors) - count

    def _product(self, values: Tensor, activation: Activation | None) -> Tensor:
        if not self.onednn:
            result = functional.linear(values, self._weight, self._bias)
            return result if activation is None else activation(result)
        missing = self._missing(values)
        if missing:
            # `functional.pad` would first write zeros everywhere, which is slow in bfloat16.
            flat = values.reshape(-1, values.shape[-1])
            filled = flat.new_empty(len(flat) + missing, flat.shape[1])
            filled[: len(flat)] = flat
            filled[len(flat) :].zero_()
            return self._product(filled, activation)[: len(flat)].view(*values.shape[:-1], len(self._bias))
        result: Tensor = self._operator(values, self._weight, self._bias, _POINTWISE[activation], [], "none")
        return result
