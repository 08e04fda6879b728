"""A short fingerprint of a model, to recognise the same model when a program holds it more than once."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Iterator
from dataclasses import fields

import torch
from torch import Tensor

from motiongen_ardy.core.stats import Stats
from motiongen_ardy.model.model import Model


def fingerprint(model: Model) -> str:
    """12 hexadecimal digits of a hash over all that is read from a checkpoint; not proof of equality.

    Every number counts: training may change some rows of a table only, and a correction the statistics of one joint.
    Tensors go in by their checksums, which take 0.2 s for a gigabyte, where hashing it takes up to several seconds.
    """
    digest = hashlib.sha256(repr((model.config, model.sampling)).encode())
    for name, tensor in sorted(_tensors(model), key=lambda entry: entry[0]):
        digest.update(repr((name, tuple(tensor.shape), _checksum(tensor))).encode())
    return digest.hexdigest()[:12]


def _tensors(model: Model) -> Iterator[tuple[str, Tensor]]:
    """The weights; the statistics, which are no part of the state; and the paces of prompts."""
    yield from model.state_dict().items()
    for name, module in model.named_modules():
        if isinstance(module, Stats):
            yield f"{name}.mean", module.mean
            yield f"{name}.std", module.std
    if model.paces is not None:
        for field in fields(model.paces):
            yield f"paces.{field.name}", torch.as_tensor(getattr(model.paces, field.name))


def _checksum(tensor: Tensor) -> int:
    return zlib.crc32(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy())
