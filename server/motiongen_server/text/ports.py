"""What the prompt encoder needs from outside, and how it asks: an encoder, and a place where vectors outlive it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Embedding: TypeAlias = NDArray[np.float32]
"""(E,)"""
Answer: TypeAlias = Embedding | Exception
"""To one text: its vector, or why there is none."""


class TextEncoder(Protocol):
    """What the workers run; `motiongen_ardy.text` has implementations.

    encode gives a row for each text, which depends on that text alone. It raises ConnectionError where the encoder
    cannot answer now, with a message that may be told to clients, and may give that an attribute `retry_after_s`.
    """

    @property
    def identity(self) -> str: ...

    def encode(self, texts: Sequence[str]) -> Embedding: ...


@runtime_checkable
class Closeable(Protocol):
    """An encoder that has calls under way which can be ended."""

    def close(self) -> None: ...


class Store(Protocol):
    """Where embeddings outlive the process; it never fails, it only forgets."""

    def get(self, text: str) -> Embedding | None: ...

    def put(self, text: str, vector: Embedding) -> None: ...

    def close(self) -> None: ...


def answers_to(texts: Sequence[str], encoder: TextEncoder) -> Mapping[str, Answer]:
    """What an encoder says to each of several texts, in one call.

    Texts of whoever asks come together, so where the call fails because of one of them, the others are asked for alone.
    """
    try:
        return {text: vector.copy() for text, vector in zip(texts, encoder.encode(texts), strict=True)}
    except Exception as error:
        if len(texts) == 1 or _is_away(error):
            return dict.fromkeys(texts, error)
    return {text: answer for each in texts for text, answer in answers_to([each], encoder).items()}


def _is_away(error: Exception) -> bool:
    """Whether it has nothing to do with any text: another call now would only fail, too, maybe after a wait."""
    return isinstance(error, ConnectionError) and getattr(error, "retry_after_s", None) is not None
