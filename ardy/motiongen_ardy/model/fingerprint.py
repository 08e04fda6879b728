"""A short fingerprint of a model's weights, to recognise the same model when a program holds it more than once."""

from __future__ import annotations

import hashlib

import torch

from motiongen_ardy.model.model import Model

SAMPLE = 64
"""Numbers of each tensor that are hashed: further training or conversion changes all of them."""


def fingerprint(model: Model) -> str:
    """12 hexadecimal digits of a hash over sampled weights, statistics and sampling options; not proof of equality."""
    tensors = sorted(model.state_dict().items())
    digest = hashlib.sha256(repr(model.sampling).encode())
    digest.update(repr([(name, tuple(tensor.shape)) for name, tensor in tensors]).encode())
    if tensors:
        sample = torch.cat([tensor.detach().flatten()[:SAMPLE].float().cpu() for _, tensor in tensors])
        digest.update(sample.numpy().tobytes())
    return digest.hexdigest()[:12]
