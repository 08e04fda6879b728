"""Interfaces of what the prompt encoder uses: a text encoder, and a store in which vectors outlive the process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Embedding: TypeAlias = NDArray[np.float32]
"""(E,)"""
Answer: TypeAlias = Embedding | Exception
"""For one text: its vector, or why there is none."""


class TextEncoder(Protocol):
    """A text encoder, called on threads; `motiongen_ardy.text` has implementations.

    encode returns a row for each text, which depends on that text alone. It raises ConnectionError if the encoder
    cannot answer now, with a message that clients may see and, optionally, an attribute `retry_after_s`.
    """

    @property
    def identity(self) -> str: ...

    def encode(self, texts: Sequence[str]) -> Embedding: ...


@runtime_checkable
class Closeable(Protocol):
    """An encoder whose calls in progress can be cancelled."""

    def close(self) -> None: ...


class Store(Protocol):
    """Keeps embeddings beyond the end of the process. It never fails, it only forgets."""

    def get(self, text: str) -> Embedding | None: ...

    def put(self, text: str, vector: Embedding) -> None: ...

    def close(self) -> None: ...


def answers_to(texts: Sequence[str], encoder: TextEncoder) -> Mapping[str, Answer]:
    """The encoder's answer to each text, from one call.

    If that call fails, possibly because of a single text, each text gets a call of its own.
    """
    try:
        return {text: vector.copy() for text, vector in zip(texts, encoder.encode(texts), strict=True)}
    except Exception as error:
        if len(texts) == 1 or _is_away(error):
            return dict.fromkeys(texts, error)
    return {text: answer for each in texts for text, answer in answers_to([each], encoder).items()}


def _is_away(error: Exception) -> bool:
    """Whether the error is not due to a text: another call now would fail too, perhaps after a wait."""
    return isinstance(error, ConnectionError) and getattr(error, "retry_after_s", None) is not None
