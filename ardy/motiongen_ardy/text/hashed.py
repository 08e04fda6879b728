"""An encoder without meaning, for tests: every word has a fixed pseudo-random vector."""

from __future__ import annotations

import hashlib
import re
from functools import lru_cache

import numpy as np

from motiongen_ardy.text.encoder import EachTextEncoder, TextWidthMismatch, Vectors


class HashedTextEncoder(EachTextEncoder):
    """A bag of words in which every word has a fixed pseudo-random vector, of any width.

    It captures no meaning; it serves for tests, and for models whose own encoder is not available.
    """

    def __init__(self, width: int) -> None:
        if width < 1:
            raise TextWidthMismatch(f"a text vector needs at least 1 number, not {width}")
        super().__init__(f"hashed-{width}", width)

    def encode_one(self, text: str) -> Vectors:
        vector = np.zeros(self.width, np.float32)
        words = re.findall(r"\w+", text.lower())
        for word in words:
            vector += _word_vector(word, self.width) / np.sqrt(len(words))
        return vector


@lru_cache(maxsize=4096)
def _word_vector(word: str, width: int) -> Vectors:
    seed = int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "little")
    return np.random.default_rng(seed).standard_normal(width).astype(np.float32)
