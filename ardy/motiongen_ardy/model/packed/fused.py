"""FusedStack: transformer layers on a GPU, with fused kernels between their matrix products.

For sequences of some tens of vectors, products take less than half of a layer's time; torch's attention, sums, casts
and norms take the rest. The products are those of `PackedLayer`; everything else differs only in the order of rounding.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from types import ModuleType
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from motiongen_ardy.model.packed.stack import Group, Norm, PackedLayer

LONGEST = 64
"""The most vectors of a sequence; torch's own attention suits longer ones."""
_HEAD_WIDTHS = (16, 32, 64, 128)
_LEAST_BLOCK = 16  # of a matrix product in Triton

log = logging.getLogger(__name__)


class FusedStack:
    """Applies the layers one after another to sequences of at most LONGEST vectors."""

    def __init__(self, layers: Sequence[PackedLayer], kernels: ModuleType) -> None:
        self._layers = layers
        self._kernels = kernels

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """The output (R, width) that is read, for vectors (P, width) float32, as in `PackedStack.__call__`."""
        with torch.cuda.device_of(vectors):  # Triton launches kernels on the current device
            return self._run(vectors, groups)

    def _run(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        first, last = self._layers[0], self._layers[-1]
        stream = vectors[: groups[-1].end]
        normed = first.before(stream).to(first.dtype)
        whole = [group._replace(first_read=0, num_read=group.length) for group in groups]
        for layer, after in pairwise(self._layers):
            stream, normed = self._attended(layer, normed, stream, whole)
            product = layer.narrow(layer.widen(normed))
            stream, normed = self._added(layer, product, stream, after.norms[0] if layer.norm_first else layer.norms[1])
        read = torch.cat([group.of(stream)[:, group.read].flatten(0, 1) for group in groups])
        stream, normed = self._attended(last, normed, read, groups)
        product = last.narrow(last.widen(normed))
        if last.norm_first:
            return product.to(stream.dtype).add_(stream)
        return self._added(last, product, stream, last.norms[1])[0]

    def _attended(
        self, layer: PackedLayer, normed: Tensor, stream: Tensor, groups: Sequence[Group]
    ) -> tuple[Tensor, Tensor]:
        """The residual stream (n, width) after attention and its norm, for the vectors of the groups that are read."""
        packed = layer.mix_in(normed)
        taken = packed.new_empty(stream.shape)
        head_width, first_taken = stream.shape[1] // layer.num_heads, 0
        for group in groups:
            self._kernels.attend[(group.num_sequences, layer.num_heads)](
                packed,
                taken,
                group.start,
                group.length,
                group.first_read,
                group.num_read,
                first_taken,
                head_width**-0.5,
                HEADS=layer.num_heads,
                WIDTH=head_width,
                KEYS=_block(group.length),
                QUERIES=_block(group.num_read),
            )
            first_taken += group.total_read
        return self._added(layer, layer.mix_out(taken), stream, layer.norms[1 if layer.norm_first else 0])

    def _added(self, layer: PackedLayer, product: Tensor, stream: Tensor, norm: Norm) -> tuple[Tensor, Tensor]:
        """The sum, or its norm where norms come last, (n, width) float32; and the norm in the layer's precision."""
        added, normed = torch.empty_like(stream), product.new_empty(product.shape)
        width = stream.shape[1]
        self._kernels.add_and_norm[(len(stream),)](
            product,
            stream,
            norm.weight,
            norm.bias,
            added,
            normed,
            norm.eps,
            WIDTH=width,
            BLOCK=_block(width),
            NORM_ADDED=not layer.norm_first,
        )
        return added, normed


def fused_stack(layers: Sequence[PackedLayer]) -> FusedStack | None:
    """The fused stack for layers in bfloat16 on a GPU; None for others, or if the kernels cannot be compiled."""
    weight = layers[0].norms[0].weight
    head_width = len(weight) // layers[0].num_heads
    if weight.device.type != "cuda" or layers[0].dtype != torch.bfloat16 or head_width not in _HEAD_WIDTHS:
        return None
    kernels = _compiled(weight.device)
    return None if kernels is None else FusedStack(layers, kernels)


def _block(size: int) -> int:
    return max(_LEAST_BLOCK, 1 << (size - 1).bit_length())


@lru_cache
def _compiled(device: torch.device) -> ModuleType | None:
    """The kernels, if Triton is available and can compile the smaller one; otherwise logs a warning that says why."""
    try:
        from motiongen_ardy.model.packed import kernels

        numbers = torch.zeros(2, 16, device=device)
        arguments = (numbers, numbers, numbers[0], numbers[0], torch.empty_like(numbers), torch.empty_like(numbers))
        with torch.cuda.device_of(numbers):
            kernels.add_and_norm[(2,)](*arguments, 1e-5, WIDTH=16, BLOCK=16, NORM_ADDED=True)
    except Exception as error:  # Triton, the C compiler that it calls, and the driver each have their own errors
        log.warning(
            "layers are called with torch's kernels, which takes longer: Triton compiles none for %s (%s: %s); it "
            "needs a C compiler (apt install gcc)", device, type(error).__name__, error,
        )  # fmt: skip
        return None
    return kernels
