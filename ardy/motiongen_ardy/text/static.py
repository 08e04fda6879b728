"""Static word-piece embeddings: the encoder that comes with the package. No network, no second process."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motiongen_ardy.text.encoder import UnknownTextEncoder, Vectors, is_blank

if TYPE_CHECKING:
    from model2vec import StaticModel

BUILT_IN_FOLDER = "text-static"


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

    def encode(self, texts: Sequence[str]) -> Vectors:
        if not texts:
            return np.zeros((0, self._width), np.float32)
        # One at a time: the library pads a batch, and a vector must not depend on its neighbours.
        vectors = np.concatenate([self._model.encode([text]) for text in texts]).astype(np.float32)
        rms = np.sqrt(np.square(vectors).mean(axis=1, keepdims=True))
        vectors = vectors / np.where(rms > 0, rms, 1)
        vectors[[is_blank(text) for text in texts]] = 0
        return np.asarray(vectors, np.float32)


def built_in_text_folder() -> Path:
    """Where the text encoder that comes with the package lies."""
    return Path(str(resources.files("motiongen_ardy") / "pretrained" / BUILT_IN_FOLDER))
