"""The seam: what turns prompts into vectors, what may be wrong with it, and what must hold of any answer."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float32]
MAX_ABSOLUTE_VALUE = 1e4
"""Of a number in a vector; encoders stay below a hundred, and what is far beyond overflows in a model's products."""


class UnknownTextEncoder(ValueError):
    """Raised for an encoder that is not known or cannot be had; the message says what can."""


class TextWidthMismatch(ValueError):
    """Raised when an encoder's vectors are not as wide as the model's text input."""


class TextEncoderUnavailable(ConnectionError):
    """Raised when an encoder cannot answer now. The message may be told to clients: it names no address.

    retry_after_s: when asking again may help; None where it will not.
    """

    retry_after_s: float | None = 2.0


class PromptNotEncoded(TextEncoderUnavailable):
    """Raised for a prompt that was not encoded beforehand, where there is no encoder."""

    retry_after_s = None


class TextRefused(TextEncoderUnavailable):
    """Raised for a text that an encoder elsewhere does not take, one that is too long for it above all."""

    retry_after_s = None


class TextEncoderChanged(TextEncoderUnavailable):
    """Raised when an encoder elsewhere is another than it was, or answers what it never should."""


class TextEncoder(Protocol):
    """What turns prompts into the vectors that condition a window.

    identity: names all that a vector depends on (the encoder, its content, its precision), so that vectors that are
    kept or sent are never mistaken for another encoder's. width: numbers in a vector.
    """

    @property
    def identity(self) -> str: ...

    @property
    def width(self) -> int: ...

    def encode(self, texts: Sequence[str]) -> Vectors:
        """(len(texts), width) float32; each row depends on its own text only, a blank text gives zeros.

        May be called from several threads. Raises TextEncoderUnavailable where the encoder is elsewhere, and ValueError
        for one text in place of a list and for texts with half of a surrogate pair.
        """
        ...


class NamedTextEncoder:
    """What every encoder here has: the identity and the width of its vectors, which never change."""

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
    """An encoder that takes one text at a time, so that no vector depends on its neighbours. As `TextEncoder`."""

    def encode(self, texts: Sequence[str]) -> Vectors:
        check_texts(texts)
        vectors = np.zeros((len(texts), self._width), np.float32)
        for row, text in enumerate(texts):
            if not is_blank(text):
                vectors[row] = checked_vector(self.encode_one(text), self._width)
        return vectors

    @abstractmethod
    def encode_one(self, text: str) -> Vectors:
        """(width,) of a text that is not blank. Raises TextEncoderUnavailable where the encoder is elsewhere."""


def check_texts(texts: Sequence[str]) -> None:
    """Raise ValueError for one text in place of a list, whose letters would be texts, and for half characters."""
    if isinstance(texts, str):
        raise ValueError(f"texts is one text, {texts[:40]!r}; give a list of texts")
    for text in texts:
        try:
            text.encode()
        except UnicodeEncodeError:  # what reads words raises whatever it likes for these
            raise ValueError(f"a text has half of a surrogate pair, {text[:40]!r}; give whole characters") from None


def is_blank(text: str) -> bool:
    """Whether a text says nothing; its vector is zeros."""
    return not text.strip()


def check_width(name: str, width: int, wanted: int) -> None:
    """Raise TextWidthMismatch unless the encoder called `name` gives vectors of the wanted width."""
    if width != wanted:
        raise TextWidthMismatch(
            f"text encoder {name!r} gives vectors of {width} numbers, but the model takes {wanted}; "
            "use the encoder the model was trained with, or hashed to try it without meaning"
        )


def checked_vector(vector: np.ndarray, width: int) -> Vectors:
    """An answer from elsewhere as (width,) float32. Raises TextEncoderChanged for one that cannot be used."""
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
