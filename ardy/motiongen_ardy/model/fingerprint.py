"""A short name of a model's weights, for programs that hold the same model more than once."""

from __future__ import annotations

import hashlib

import torch

from motiongen_ardy.model.model import Model

SAMPLE = 64
"""Numbers of each tensor that count: whoever trains on, or converts, changes all of them."""


def fingerprint(model: Model) -> str:
    """12 hexadecimal digits that differ where weights, statistics or the way of sampling do; no proof of equality."""
    tensors = sorted(model.state_dict().items())
    digest = hashlib.sha256(repr(model.sampling).encode())
    digest.update(repr([(name, tuple(tensor.shape)) for name, tensor in tensors]).encode())
    if tensors:
        sample = torch.cat([tensor.detach().flatten()[:SAMPLE].float().cpu() for _, tensor in tensors])
        digest.update(sample.numpy().tobytes())
    return digest.hexdigest()[:12]
