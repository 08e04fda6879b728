"""Prompts in the form that windows take. Many windows share one, so a call copies each text to the device only once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.model.config import DenoiserConfig
from motiongen_server.engine.types import Float32Array

MOST_HELD = 1024


class Prompt(NamedTuple):
    """text: (n, W), zeros for no prompt. is_told: whether there is a prompt."""

    text: Tensor
    is_told: bool


class Prompts:
    """Embeddings as texts with the model's number of vectors: shorter ones are padded, longer ones cut."""

    def __init__(self, config: DenoiserConfig) -> None:
        self._shape = config.text_tokens, config.text_dim
        self._nothing = Prompt(torch.zeros(self._shape), False)
        # Keyed by the array's id(), which is unique as long as the array is kept in the value.
        self._held: OrderedDict[int, tuple[Float32Array, Prompt]] = OrderedDict()

    def of(self, embedding: Float32Array | None) -> Prompt:
        """embedding: (W) or (n, W), which must never change; None for no prompt."""
        if embedding is None:
            return self._nothing
        held = self._held.get(id(embedding))
        if held is None:
            held = self._held[id(embedding)] = embedding, self._made(embedding)
            if len(self._held) > MOST_HELD:
                self._held.popitem(last=False)
        return held[1]

    def _made(self, embedding: Float32Array) -> Prompt:
        text = np.zeros(self._shape, np.float32)
        vectors = np.atleast_2d(embedding)[: self._shape[0]]
        text[: len(vectors)] = vectors
        return Prompt(torch.from_numpy(text), bool(embedding.any()))


def texts_on(device: torch.device, texts: Sequence[Tensor]) -> Tensor:
    """Texts (n, W) stacked on a device: (B, n, W)."""
    numbers: dict[int, int] = {}
    which = [numbers.setdefault(id(text), len(numbers)) for text in texts]
    if device.type == "cpu" or len(numbers) == len(texts):
        return torch.stack(list(texts)).to(device)
    distinct = {id(text): text for text in texts}  # in the order of the numbers
    return torch.stack(list(distinct.values())).to(device)[torch.tensor(which).to(device)]
