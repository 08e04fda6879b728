"""Text encoders: prompt -> one vector. The denoiser takes the vectors as they are; a blank prompt is a zero vector."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from model2vec import StaticModel

BUILT_IN_FOLDER = "text-static"


class UnknownTextEncoder(ValueError):
    """Raised for a name that is neither a known encoder nor a readable folder; the message lists what is known."""


class TextWidthMismatch(ValueError):
    """Raised when an encoder's vectors are not as wide as the model's text input."""


class TextEncoder(Protocol):
    """What turns prompts into the vectors that condition a window.

    identity: name and content hash, so that cached vectors are never mistaken for another encoder's.
    width: numbers in a vector.
    """

    @property
    def identity(self) -> str: ...

    @property
    def width(self) -> int: ...

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        """(len(texts), width) float32; each row depends on its own text only, a blank text gives zeros."""
        ...


class StaticTextEncoder:
    """Static word-piece embeddings (model2vec): a prompt is the mean of its pieces' vectors, scaled to unit RMS.

    The folder is read without network. Encoding takes well under a millisecond.
    """

    def __init__(self, folder: Path) -> None:
        from model2vec import StaticModel  # takes a moment to import, and most of the library does not need it

        try:
            self._model: StaticModel = StaticModel.from_pretrained(folder)
        except (OSError, ValueError, KeyError) as error:
            raise UnknownTextEncoder(f"{folder} is not a model2vec folder: {error}") from error
        digest = hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()[:12]
        self._identity = f"static-{digest}"
        self._width = int(self._model.dim)

    @property
    def identity(self) -> str:
        return self._identity

    @property
    def width(self) -> int:
        return self._width

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        if not texts:
            return np.zeros((0, self._width), np.float32)
        # One at a time: the library pads a batch, and a vector must not depend on its neighbours.
        vectors = np.concatenate([self._model.encode([text]) for text in texts]).astype(np.float32)
        rms = np.sqrt(np.square(vectors).mean(axis=1, keepdims=True))
        vectors = vectors / np.where(rms > 0, rms, 1)
        blank = np.array([not text.strip() for text in texts])
        vectors[blank] = 0
        return np.asarray(vectors, np.float32)


class HashedTextEncoder:
    """A bag of words in which every word has a fixed pseudo-random vector, of any width.

    It knows nothing of meaning; it serves tests, and models whose own encoder is not at hand.
    """

    def __init__(self, width: int) -> None:
        if width < 1:
            raise TextWidthMismatch(f"a text vector needs at least 1 number, not {width}")
        self._width = width

    @property
    def identity(self) -> str:
        return f"hashed-{self._width}"

    @property
    def width(self) -> int:
        return self._width

    def encode(self, texts: Sequence[str]) -> NDArray[np.float32]:
        vectors = np.zeros((len(texts), self._width), np.float32)
        for row, text in enumerate(texts):
            words = re.findall(r"\w+", text.lower())
            for word in words:
                vectors[row] += _word_vector(word, self._width) / np.sqrt(len(words))
        return vectors


@lru_cache(maxsize=4096)
def _word_vector(word: str, width: int) -> NDArray[np.float32]:
    seed = int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "little")
    return np.random.default_rng(seed).standard_normal(width).astype(np.float32)


def built_in_text_folder() -> Path:
    """Where the text encoder that comes with the package lies."""
    return Path(str(resources.files("ardy") / "pretrained" / BUILT_IN_FOLDER))


def load_text_encoder(name: str, width: int) -> TextEncoder:
    """The encoder called `name`: "static" (built in), "hashed", or a model2vec folder; `width` is what the model takes.

    Raises UnknownTextEncoder, and TextWidthMismatch when the encoder's vectors are not `width` wide.
    """
    if name == "hashed":
        return HashedTextEncoder(width)
    folder = built_in_text_folder() if name == "static" else Path(name)
    if not (folder / "model.safetensors").is_file():
        raise UnknownTextEncoder(f"no text encoder {name!r}; use static, hashed, or a folder that model2vec wrote")
    encoder = StaticTextEncoder(folder)
    if encoder.width != width:
        raise TextWidthMismatch(
            f"text encoder {name!r} gives vectors of {encoder.width} numbers, but the model takes {width}; "
            "use the encoder the model was trained with, or hashed to try it without meaning"
        )
    return encoder
