"""Static word-piece embeddings: the encoder included in the package. Needs no network and no second process."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from motiongen_ardy.text.encoder import NamedTextEncoder, UnknownTextEncoder, Vectors, check_texts, is_blank

if TYPE_CHECKING:
    from model2vec import StaticModel

BUILT_IN_FOLDER = "text-static"


class StaticTextEncoder(NamedTextEncoder):
    """Static word-piece embeddings (model2vec): the mean of the vectors of a prompt's pieces, scaled to unit RMS.

    The folder is read without network access. Encoding takes well under a millisecond. Only the first pieces of a long
    text count, as many as the folder's `max_length`, or 512 if it has none.
    """

    def __init__(self, folder: Path) -> None:
        from model2vec import StaticModel  # slow to import, and most of the library does not need it

        try:
            self._model: StaticModel = StaticModel.from_pretrained(folder)
            if not all(np.isfinite(numbers).all() for numbers in (self._model.embedding, self._model.weights)
                       if numbers is not None):  # fmt: skip
                raise UnknownTextEncoder(f"{folder} holds vectors that are not finite, so no prompt's vector would be")
        except UnknownTextEncoder:
            raise
        except Exception as error:  # the libraries that read its files share no error class
            raise UnknownTextEncoder(f"{folder} is not a model2vec folder: {error}") from error
        digest = hashlib.sha256((folder / "model.safetensors").read_bytes()).hexdigest()[:12]
        super().__init__(f"static-{digest}", int(self._model.dim))

    def encode(self, texts: Sequence[str]) -> Vectors:
        check_texts(texts)
        vectors = np.zeros((len(texts), self._width), np.float32)
        rows = [row for row, text in enumerate(texts) if not is_blank(text)]
        if rows:  # one call costs as much as four texts; each result is still the mean of its own pieces
            vectors[rows] = self._model.encode([texts[row] for row in rows], use_multiprocessing=False)
        rms = np.sqrt(np.square(vectors).mean(axis=1, keepdims=True))
        return np.asarray(vectors / np.where(rms > 0, rms, 1), np.float32)


def built_in_text_folder() -> Path:
    """The folder of the text encoder that is included in the package."""
    return Path(str(resources.files("motiongen_ardy") / "pretrained" / BUILT_IN_FOLDER))
