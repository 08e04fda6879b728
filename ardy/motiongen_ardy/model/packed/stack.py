"""The transformer layers on packed sequences: linear layers see no padding, attention needs no mask.

The last layer is evaluated only for the vectors that are read after it, two thirds of a denoiser's; the others
contribute only keys and values. Products and attention use the requested precision. The residual stream from layer to
layer, and its norms, are float32: in bfloat16 it would be rounded twice per layer, which shows as jitter.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from motiongen_ardy.model.packed.fused import LONGEST, fused_stack
from motiongen_ardy.model.packed.linear import PackedLinear, filled_size
from motiongen_ardy.model.transformer import TransformerLayer, TransformerStack


class Group(NamedTuple):
    """`num_sequences` sequences of `length` vectors each, starting at vector `start` of the packed tensor.

    first_read, num_read: in each sequence, the vectors that are read after the last layer.
    """

    start: int
    num_sequences: int
    length: int
    first_read: int
    num_read: int

    @property
    def end(self) -> int:
        return self.start + self.num_sequences * self.length

    def of(self, packed: Tensor) -> Tensor:
        """The group's part (num_sequences, length, C) of a packed tensor (P, C), as a view."""
        return packed[self.start : self.end].view(self.num_sequences, self.length, -1)

    @property
    def total_read(self) -> int:
        """The vectors that are read, over all its sequences."""
        return self.num_sequences * self.num_read

    @property
    def read(self) -> slice:
        """The vectors of a sequence that are read."""
        return slice(self.first_read, self.first_read + self.num_read)


class Norm:
    """A layer norm without the overhead of a module call."""

    def __init__(self, layer: nn.LayerNorm) -> None:
        self._shape = layer.normalized_shape
        self.weight, self.bias, self.eps = layer.weight, layer.bias, layer.eps

    def __call__(self, vectors: Tensor) -> Tensor:
        return torch.layer_norm(vectors, self._shape, self.weight, self.bias, self.eps)


_ALL = slice(None)


class PackedLayer:
    """One transformer layer; its weights are copies in the precision in which it computes."""

    def __init__(self, layer: TransformerLayer, dtype: torch.dtype) -> None:
        attention = layer.self_attn
        self.dtype = dtype
        self.num_heads = attention.num_heads
        self.norm_first = layer.norm_first
        self.norms = (Norm(layer.norm1), Norm(layer.norm2))
        self.mix_in = PackedLinear(attention.in_proj_weight, attention.in_proj_bias, dtype)
        self.mix_out = PackedLinear.of(attention.out_proj, dtype)
        self.widen = PackedLinear.of(layer.linear1, dtype, layer.activation)
        self.narrow = PackedLinear.of(layer.linear2, dtype)

    def _attention(self, vectors: Tensor, groups: Sequence[Group], asking: Sequence[slice], count: int) -> Tensor:
        """Attention output before the output projection, padded with zeros to `count` vectors.

        asking: in each group's sequences, the vectors that are queries.
        """
        packed = self.mix_in(vectors.to(self.dtype)).view(len(vectors), 3, self.num_heads, -1)
        taken = packed.new_empty(count, *packed.shape[2:])
        end = 0
        for group, part in zip(groups, asking, strict=True):
            sequences = packed[group.start : group.end].unflatten(0, (group.num_sequences, group.length))
            query, key, value = sequences.permute(2, 0, 3, 1, 4)
            mixed = functional.scaled_dot_product_attention(query[:, :, part], key, value).transpose(1, 2)
            start, end = end, end + mixed.shape[0] * mixed.shape[1]
            taken[start:end].unflatten(0, mixed.shape[:2]).copy_(mixed)
        taken[end:].zero_()
        return taken.flatten(1)

    def __call__(self, vectors: Tensor, groups: Sequence[Group]) -> Tensor:
        return self._after(vectors, self._attention(self.before(vectors), groups, [_ALL] * len(groups), len(vectors)))

    def of_read(self, vectors: Tensor, groups: Sequence[Group], count: int) -> Tensor:
        """(count, width): the layer's result for the vectors that are read only, group after group, then for zeros."""
        attended = self._attention(self.before(vectors), groups, [group.read for group in groups], count)
        read = vectors.new_empty(count, vectors.shape[1])
        end = 0
        for group in groups:
            start, end = end, end + group.total_read
            read[start:end].unflatten(0, (-1, group.num_read)).copy_(group.of(vectors)[:, group.read])
        read[end:].zero_()
        return self._after(read, attended)

    def before(self, vectors: Tensor) -> Tensor:
        """Vectors as attention takes them: normed if norms come first."""
        return self.norms[0](vectors) if self.norm_first else vectors

    def _after(self, vectors: Tensor, attended: Tensor) -> Tensor:
        """The rest of the layer for vectors (n, width), after attention."""
        first, second = self.norms
        if self.norm_first:
            vectors = self.mix_out.plus(attended, vectors)
            return self.narrow.plus(self.widen(second(vectors).to(self.dtype)), vectors)
        vectors = first(self.mix_out.plus(attended, vectors))
        result: Tensor = second(self.narrow.plus(self.widen(vectors.to(self.dtype)), vectors))
        return result


class PackedStack:
    """All layers of a `TransformerStack`."""

    def __init__(self, stack: TransformerStack, dtype: torch.dtype) -> None:
        self._originals = [layer for layer in stack.layers if isinstance(layer, TransformerLayer)]
        self.layers = [PackedLayer(layer, dtype) for layer in self._originals]
        self._fills = any(layer.mix_in.onednn for layer in self.layers)
        self._fused = fused_stack(self.layers)

    def filled(self, vectors: int) -> int:
        """The number to pad vectors to once, instead of padding in each product."""
        return filled_size(vectors) if self._fills else vectors

    def release_originals(self) -> None:
        """Free the weight matrices of which the layers hold copies; the original stack becomes unusable."""
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
        """The output (R, width) that is read, group after group, from vectors (P, width) float32.

        P: at least the groups' vectors; any further ones are ignored. The argument is not changed.
        """
        if self._fused is not None and max(group.length for group in groups) <= LONGEST:
            return self._fused(vectors, groups)
        for layer in self.layers[:-1]:
            vectors = layer(vectors, groups)
        total = sum(group.total_read for group in groups)
        return self.layers[-1].of_read(vectors, groups, self.filled(total))[:total]
