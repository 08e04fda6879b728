"""A tokenizer as it is served: a row's result does not depend on how many rows are encoded or decoded with it."""

from __future__ import annotations

import copy

import torch
from torch import Tensor, nn

from motiongen_ardy.model.packed.linear import PackedLinear
from motiongen_ardy.model.tokenizer.explicit import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer
from motiongen_ardy.model.transformer import SelfAttention, TransformerLayer


class _PackedLayer(nn.Module):
    """Takes the place of an `nn.Linear`."""

    def __init__(self, packed: PackedLinear) -> None:
        super().__init__()
        self._packed = packed

    def forward(self, values: Tensor) -> Tensor:
        """values: (..., in) float32."""
        return self._packed(values)


class _PackedAttention(SelfAttention):
    """Self-attention with packed projections."""

    def __init__(self, plain: SelfAttention) -> None:
        nn.Module.__init__(self)
        self.num_heads = plain.num_heads
        self.out_proj = plain.out_proj
        self._mix_in = PackedLinear(plain.in_proj_weight, plain.in_proj_bias, torch.float32)

    def projected(self, tokens: Tensor) -> Tensor:
        """Queries, keys and values side by side."""
        return self._mix_in(tokens)


def _fuse_activation(layer: TransformerLayer) -> None:
    """Apply the activation within the product before it.

    A separate activation would need a oneDNN kernel for each batch shape, and those displace the kernels of products.
    """
    widen = PackedLinear.of(layer.linear1, torch.float32, layer.activation)
    setattr(layer, "linear1", _PackedLayer(widen))  # noqa: B010
    setattr(layer, "activation", nn.Identity())  # noqa: B010


def packed_codec(codec: Tokenizer | ExplicitBody) -> Tokenizer | ExplicitBody:
    """The same codec with packed float32 layers: faster, and independent of what else is in the batch.

    The codec that is given is left unchanged; layers in another precision are not packed.
    """
    if isinstance(codec, ExplicitBody) or codec.encoder.precision is not torch.float32:
        return codec
    packed = copy.copy(codec)
    packed._modules = dict(codec._modules)
    packed.encoder, packed.decoder = copy.deepcopy(codec.encoder), copy.deepcopy(codec.decoder)
    for network in (packed.encoder, packed.decoder):
        for module in list(network.modules()):
            for name, part in list(module.named_children()):
                if isinstance(part, SelfAttention):
                    setattr(module, name, _PackedAttention(part))
            if isinstance(module, TransformerLayer):
                _fuse_activation(module)
        for module in list(network.modules()):
            for name, part in list(module.named_children()):
                if isinstance(part, nn.Linear):
                    setattr(module, name, _PackedLayer(PackedLinear.of(part, torch.float32)))
    return packed
