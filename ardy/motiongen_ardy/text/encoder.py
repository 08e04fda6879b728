"""The interface of text encoders, their errors, and the checks that every vector must pass."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float32]
MAX_ABSOLUTE_VALUE = 1e4
"""Of a number in a vector. Encoders stay below a hundred; far larger numbers would overflow in a model's products."""


class UnknownTextEncoder(ValueError):
    """Raised for an encoder that is unknown or cannot be loaded; the message says which can."""


class TextWidthMismatch(ValueError):
    """Raised when an encoder's vectors are not as wide as the model's text input."""


class TextEncoderUnavailable(ConnectionError):
    """Raised when an encoder cannot answer now. The message names no address, so it may be shown to clients.

    retry_after_s: after how many seconds a retry may help; None if it will not.
    """

    retry_after_s: float | None = 2.0


class PromptNotEncoded(TextEncoderUnavailable):
    """Raised for a prompt that was not encoded beforehand, when there is no encoder."""

    retry_after_s = None


class TextRefused(TextEncoderUnavailable):
    """Raised for a text that a remote encoder does not accept, mostly because it is too long."""

    retry_after_s = None


class TextEncoderChanged(TextEncoderUnavailable):
    """Raised when a remote encoder is no longer the one it was, or gives an invalid answer."""


class TextEncoder(Protocol):
    """Turns prompts into the vectors that condition a window.

    identity: names everything that a vector depends on (the encoder, its weights, its precision), so that stored or
    transmitted vectors are never mistaken for those of another encoder. width: numbers in a vector.
    """

    @property
    def identity(self) -> str: ...

    @property
    def width(self) -> int: ...

    def encode(self, texts: Sequence[str]) -> Vectors:
        """(len(texts), width) float32; each row depends only on its own text; a blank text gives zeros.

        Thread-safe. Raises TextEncoderUnavailable if a remote encoder does not answer, and ValueError for a single
        text instead of a list and for texts with half of a surrogate pair.
        """
        ...


class NamedTextEncoder:
    """Base of all encoders here: holds the identity and the width of the vectors, which never change."""

    def __init__(self, identity: str, width: int) -> None:
        self._identity = identity
        self._width = width

    @property
    def identity(self) -> str:
        return self._identity

    @property
    def width(self) -> int:
        return self._width


class EachTextEncoder(NamedTextEncoder, ABC):
    """A `TextEncoder` that encodes one text at a time, so that no vector depends on other texts."""

    def encode(self, texts: Sequence[str]) -> Vectors:
        check_texts(texts)
        vectors = np.zeros((len(texts), self._width), np.float32)
        for row, text in enumerate(texts):
            if not is_blank(text):
                vectors[row] = checked_vector(self.encode_one(text), self._width)
        return vectors

    @abstractmethod
    def encode_one(self, text: str) -> Vectors:
        """(width,) for a text that is not blank. Raises TextEncoderUnavailable if a remote encoder does not answer."""


def check_texts(texts: Sequence[str]) -> None:
    """Raise ValueError for a single text instead of a list, whose letters would be texts, and for half characters."""
    if isinstance(texts, str):
        raise ValueError(f"texts is one text, {texts[:40]!r}; give a list of texts")
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError:  # tokenizers raise arbitrary errors for these
            raise ValueError(f"a text has half of a surrogate pair, {text[:40]!r}; give whole characters") from None


def is_blank(text: str) -> bool:
    """Whether a text has no content; its vector is zeros."""
    return not text.strip()


def check_width(name: str, width: int, wanted: int) -> None:
    """Raise TextWidthMismatch unless the encoder called `name` gives vectors of the wanted width."""
    if width != wanted:
        raise TextWidthMismatch(
            f"text encoder {name!r} gives vectors of {width} numbers, but the model takes {wanted}; "
            "use the encoder the model was trained with, or hashed to try it without meaning"
        )


def checked_vector(vector: np.ndarray, width: int) -> Vectors:
    """A remote encoder's answer as (width,) float32. Raises TextEncoderChanged if it cannot be used."""
    if vector.shape not in ((width,), (1, width)):
        raise TextEncoderChanged(
            f"the text encoder answered with an array of shape {vector.shape}; it must be ({width},) or (1, {width})"
        )
    flat = np.array(vector.reshape(width), np.float32)
    if not bool((np.abs(flat) <= MAX_ABSOLUTE_VALUE).all()):
        raise TextEncoderChanged(
            f"the text encoder answered with numbers that are not finite, or beyond {MAX_ABSOLUTE_VALUE:,.0f}"
        )
    return flat
