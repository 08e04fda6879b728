"""A file of prompts with their vectors, computed beforehand, so that the encoder is not needed when they are used.

safetensors: the tensor `vectors` (N, W) float32; the metadata hold the encoder, the ids and the texts.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.text.encoder import (
    MAX_ABSOLUTE_VALUE,
    EachTextEncoder,
    PromptNotEncoded,
    TextEncoder,
    UnknownTextEncoder,
    Vectors,
    is_blank,
)

FORMAT = "motiongen-prompts-1"
MAX_FILE_BYTES = 1 << 30
MAX_ID_CHARACTERS = 64


class PromptFileError(UnknownTextEncoder):
    """Raised for a prompt file that cannot be used; the message says what is wrong with it."""


@dataclass(frozen=True, eq=False)
class PromptFile:
    """Prompts of one encoder. ids, texts: N of each, all different; vectors: (N, W) float32, finite."""

    text_encoder: str
    ids: tuple[str, ...]
    texts: tuple[str, ...]
    vectors: Vectors

    def __post_init__(self) -> None:
        """Raises PromptFileError."""
        if self.vectors.ndim != 2 or len(self.vectors) != len(self.ids) or len(self.ids) != len(self.texts):
            raise PromptFileError(
                f"{len(self.ids)} ids, {len(self.texts)} texts and vectors of shape {self.vectors.shape} do not fit"
            )
        if self.vectors.dtype != np.float32 or not bool((np.abs(self.vectors) <= MAX_ABSOLUTE_VALUE).all()):
            raise PromptFileError(
                f"the vectors must be finite numbers in float32, at most {MAX_ABSOLUTE_VALUE:,.0f} in absolute value"
            )
        check_prompts(self.ids, self.texts)


def check_prompts(ids: Sequence[str], texts: Sequence[str]) -> None:
    """Raise PromptFileError unless a file can hold these ids and texts; to be called before encoding."""
    for what, values in (("id", ids), ("text", texts)):
        if len(set(values)) < len(values):
            twice = next(value for value, count in Counter(values).items() if count > 1)
            raise PromptFileError(f"the {what} {twice[:80]!r} is there twice")
    for identifier in ids:
        if not 0 < len(identifier) <= MAX_ID_CHARACTERS:
            raise PromptFileError(f"the id {identifier[:80]!r} must have 1 to {MAX_ID_CHARACTERS} characters")
    if any(is_blank(text) for text in texts):
        raise PromptFileError("a prompt is blank; no prompt at all means the same")
    for value in (*ids, *texts):
        try:
            value.encode()
        except UnicodeEncodeError:  # JSON escapes can produce it; no message can carry it
            raise PromptFileError(f"an id or a text has half of a surrogate pair: {value[:80]!r}") from None


def id_of(text: str) -> str:
    """The id of a prompt without one: the prompt itself; if it is too long, its beginning and a hash of the whole."""
    if len(text) <= MAX_ID_CHARACTERS:
        return text
    mark = "~" + hashlib.sha256(text.encode()).hexdigest()[:8]
    return text[: MAX_ID_CHARACTERS - len(mark)].rstrip() + mark


def check_place(path: Path) -> None:
    """Raise PromptFileError unless a file can be written at `path`."""
    if not path.parent.is_dir() or not os.access(path.parent, os.W_OK | os.X_OK):
        raise PromptFileError(f"{path} cannot be written: {path.parent} is no folder that can be written to")
    if path.is_dir():
        raise PromptFileError(f"{path} cannot be written: it is a folder")


def encode_prompts(encoder: TextEncoder, prompts: Sequence[tuple[str, str]]) -> PromptFile:
    """The pairs (id, text) with their vectors. Raises PromptFileError before encoding, and the encoder's errors."""
    ids, texts = tuple(name for name, _ in prompts), tuple(text for _, text in prompts)
    check_prompts(ids, texts)
    return PromptFile(encoder.identity, ids, texts, encoder.encode(texts))


def write_prompt_file(path: Path, prompts: PromptFile) -> None:
    """Write the file, atomically replacing any earlier one. Raises PromptFileError if that is not possible."""
    from safetensors import SafetensorError
    from safetensors.numpy import save_file

    metadata = {
        "format": FORMAT,
        "text_encoder": prompts.text_encoder,
        "ids": json.dumps(prompts.ids),
        "texts": json.dumps(prompts.texts),
    }
    try:
        with written_whole(path) as partial:
            save_file({"vectors": np.ascontiguousarray(prompts.vectors)}, partial, metadata)
    except (SafetensorError, OSError) as error:
        raise PromptFileError(f"{path} cannot be written: {error}") from error


def read_prompt_file(path: Path) -> PromptFile:
    """The prompts in a file written by `write_prompt_file`. Raises PromptFileError."""
    from safetensors import SafetensorError, safe_open

    try:
        if path.exists() and not path.is_file():  # reading a pipe would block
            raise PromptFileError(f"{path} cannot be read: it is no regular file")
        if path.stat().st_size > MAX_FILE_BYTES:
            raise PromptFileError(f"{path} has more than {MAX_FILE_BYTES} bytes")
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT or list(file.keys()) != ["vectors"]:
                raise PromptFileError(f"{path} is no file of prompts; make one with python -m motiongen_ardy.text")
            if (kind := file.get_slice("vectors").get_dtype()) != "F32":  # numpy does not know all types
                raise PromptFileError(f"the vectors of {path} are {kind}; they must be finite numbers in float32")
            vectors = file.get_tensor("vectors")
        ids, texts = (_strings(metadata.get(name, ""), name) for name in ("ids", "texts"))
        return PromptFile(metadata.get("text_encoder", ""), ids, texts, vectors)
    except OSError as error:
        raise PromptFileError(f"{path} cannot be read: {error.strerror or error}") from error
    except SafetensorError as error:
        raise PromptFileError(f"{path} is no safetensors file: {error}") from error


def _strings(text: str, name: str) -> tuple[str, ...]:
    try:
        values = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PromptFileError(f"its {name} are no JSON: {str(error)[:200]}") from error
    if not isinstance(values, list) or not all(isinstance(value, str) for value in values):
        raise PromptFileError(f"its {name} are no list of strings")
    return tuple(values)


class PromptFileEncoder(EachTextEncoder):
    """Knows only the prompts of a file; it has the identity of the encoder that encoded them."""

    def __init__(self, prompts: PromptFile) -> None:
        super().__init__(prompts.text_encoder, int(prompts.vectors.shape[1]))
        self._known = dict(zip(prompts.texts, prompts.vectors, strict=True))

    def encode_one(self, text: str) -> Vectors:
        if text not in self._known:
            raise PromptNotEncoded("the prompt is not among those that were encoded in advance")
        return self._known[text]
