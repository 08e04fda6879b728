"""The transformer layers on sequences packed one behind another: linear layers see no padding, attention no mask.

Products and attention are in the precision that is asked for. What runs past them from layer to layer, and its norms,
is float32: in bfloat16 it would be rounded twice a layer, which shows as jitter in the motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.model.packed.linear import PackedLinear, filled_size
from motiongen_ardy.model.transformer import TransformerLayer, TransformerStack


class Group(NamedTuple):
    """`num_sequences` sequences of `length` vectors each, from vector `start` of the packed tensor on."""

    start: int
    num_sequences: int
    length: int

    @property
    def end(self) -> int:
        return self.start + self.num_sequences * self.length

    def of(self, packed: Tensor) -> Tensor:
        """The group's part (num_sequences, length, C) of a packed tensor (P, C), as a view."""
        return packed[self.start : self.end].view(self.num_sequences, self.length, -1)


class Norm:
    """A layer norm, called without what a module does about its calls."""

    def __init__(self, layer: nn.LayerNorm) -> None:
        self._arguments = layer.normalized_shape, layer.weight, layer.bias, layer.eps

    def __call__(self, vectors: Tensor) -> Tensor:
        return torch.layer_norm(vectors, *self._arguments)


class PackedLayer:
    """One transformer layer; its weights are copies in the precision that it computes in."""

    def __init__(self, layer: TransformerLayer, dtype: torch.dtype) -> None:
        attention = layer.self_attn
        self.dtype = dtype
        self.num_heads = attention.num_heads
        self.norm_first = layer.norm_first
        self._norms = (Norm(layer.norm1), Norm(layer.norm2))
        self.mix_in = PackedLinear(attention.in_proj_weight, attention.in_proj_bias, dtype)
        self.mix_out = PackedLinear.of(attention.out_proj, dtype)
        self.widen = PackedLinear.of(layer.linear1, dtype, layer.activation)
        self.narrow = PackedLinear.of(layer.linear2, dtype)

    def _attention(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """What each vector takes from its sequence, before the output projection; zeros behind the last sequence."""
        packed = self.mix_in(vectors.to(self.dtype)).view(len(vectors), 3, self.num_heads, -1)
        taken = packed.new_empty(len(vectors), *packed.shape[2:])
        for group in groups:
            part = slice(group.start, group.end)
            shape = group.num_sequences, group.length
            query, key, value = packed[part].unflatten(0, shape).permute(2, 0, 3, 1, 4)
            mixed = functional.scaled_dot_product_attention(query, key, value)
            taken[part].unflatten(0, shape).copy_(mixed.transpose(1, 2))
        taken[groups[-1].end :].zero_()
        return taken.flatten(1)

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        first, second = self._norms
        if self.norm_first:
            vectors = self.mix_out.plus(self._attention(first(vectors), groups), vectors)
            return self.narrow.plus(self.widen(second(vectors).to(self.dtype)), vectors)
        vectors = first(self.mix_out.plus(self._attention(vectors, groups), vectors))
        result: Tensor = second(self.narrow.plus(self.widen(vectors.to(self.dtype)), vectors))
        return result


class PackedStack:
    """All layers of a `TransformerStack`."""

    def __init__(self, stack: TransformerStack, dtype: torch.dtype) -> None:
        self._originals = [layer for layer in stack.layers if isinstance(layer, TransformerLayer)]
        self.layers = [PackedLayer(layer, dtype) for layer in self._originals]
        self._fills = any(layer.mix_in.onednn for layer in self.layers)

    def filled(self, vectors: int) -> int:
        """How many vectors to fill so many up to, once, where otherwise each product would fill up its own."""
        return filled_size(vectors) if self._fills else vectors

    def release_originals(self) -> None:
        """Free the matrices that the layers here are copies of; the stack they were made from is of no more use."""
        for layer in self._originals:
            attention = layer.self_attn
            for matrix in (
                attention.in_proj_weight,
                attention.out_proj.weight,
                layer.linear1.weight,
                layer.linear2.weight,
            ):
                matrix.data = matrix.new_empty(0)

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        """vectors: (P, width) float32, the groups one behind another, and maybe more, which are not looked at.

        The argument is not changed.
        """
        for layer in self.layers:
            vectors = layer(vectors, groups)
        return vectors
