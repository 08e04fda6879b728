"""The prompt domain: how far a prompt is from the captions of a training set, in the space of its text encoder.

Captions are scaled to unit vectors, and their mean, which says little more than that somebody does something, is
subtracted; what remains is compared by direction. A few hundred captions represent all: no other is far from one of
them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.text.encoder import Vectors

DOMAIN_FILE = "prompt_domain.safetensors"
FORMAT = "motiongen-prompt-domain-1"
MAX_FILE_BYTES = 8 << 20
_LEVELS = 127


class DomainError(ValueError):
    """Raised for a file that is not a prompt domain, and for captions from which none can be made."""


@dataclass(frozen=True, eq=False)
class PromptDomain:
    """mean: (W,) float32, of the captions' unit vectors. directions: (N, W) float32, unit vectors from it to captions.

    threshold: a prompt at a greater distance is outside. text_encoder: the identity of the encoder of the vectors.
    """

    text_encoder: str
    mean: Vectors
    directions: Vectors
    threshold: float

    def distances(self, vectors: Vectors) -> Vectors:
        """(N, W) prompts -> (N,): one minus the cosine to the nearest caption, from 0 to 2."""
        result: Vectors = 1 - (_directions(vectors, self.mean) @ self.directions.T).max(axis=1)
        return result


def make_domain(text_encoder: str, captions: Vectors, most: int, threshold: float = 1.0) -> PromptDomain:
    """The domain of captions (N, W), of which at most `most` are kept: each the furthest from those before it.

    Raises DomainError if there are no captions that differ.
    """
    if not len(captions) or most < 1:
        raise DomainError(f"there are {len(captions)} captions, of which {most} are to be kept; give one at least")
    mean, directions, kept = spread_out(captions, most)
    # As they will be read back: rounded to 127ths of the largest number.
    return PromptDomain(text_encoder, mean, _from_levels(_levels(directions[kept])), threshold)


def spread_out(captions: Vectors, most: int) -> tuple[Vectors, Vectors, list[int]]:
    """The mean (W,) of captions (N, W) as unit vectors, the directions (N, W) from it to them, and the indices of at
    most `most` captions that represent the rest: each the furthest from those before it.

    Raises DomainError if the captions do not differ, since there is then no direction from their mean to any of them.
    """
    if not len(captions) or float(np.ptp(_units(captions), axis=0).max()) < 1e-6:
        raise DomainError(f"no two captions differ, of {len(captions)}; a prompt is compared with two at least")
    mean = _units(captions).mean(axis=0).astype(np.float32)
    directions = _directions(captions, mean)
    kept = [int((_units(captions) @ mean).argmax())]
    distances = np.full(len(captions), np.inf)
    while len(kept) < most:
        distances = np.minimum(distances, 1 - directions @ directions[kept[-1]])
        furthest = int(distances.argmax())
        if distances[furthest] < 1e-6:
            break
        kept.append(furthest)
    return mean, directions, kept


def best_threshold(inside: Vectors, outside: Vectors) -> tuple[float, int, int]:
    """The threshold that best separates distances (N,) of prompts inside from (M,) outside, by the sum of error shares.

    Returns it, how many inside are above it, and how many outside are not. Raises DomainError if one of them is empty.
    """
    if not len(inside) or not len(outside):
        raise DomainError("a threshold needs prompts inside and prompts outside")
    marks = np.unique(np.concatenate([inside, outside]))
    between = (marks[1:] + marks[:-1]) / 2 if len(marks) > 1 else marks
    wrong = [float((inside > mark).mean() + (outside <= mark).mean()) for mark in between]
    best = float(between[int(np.argmin(wrong))])
    return best, int((inside > best).sum()), int((outside <= best).sum())


def write_domain(path: Path, domain: PromptDomain) -> None:
    """Write the file, atomically replacing any earlier one."""
    from safetensors.numpy import save_file

    metadata = {"format": FORMAT, "text_encoder": domain.text_encoder, "threshold": repr(domain.threshold)}
    tensors = {"mean": np.ascontiguousarray(domain.mean), "directions": _levels(domain.directions)}
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        save_file(tensors, partial, metadata)


def read_domain(path: Path) -> PromptDomain:
    """The domain in a file written by `write_domain`. Raises DomainError."""
    from safetensors import SafetensorError, safe_open

    try:
        if not path.is_file() or path.stat().st_size > MAX_FILE_BYTES:
            raise DomainError(f"{path} is no file of at most {MAX_FILE_BYTES} bytes")
        with safe_open(path, framework="numpy") as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT or set(file.keys()) != {"mean", "directions"}:
                raise DomainError(
                    f"{path} is no prompt domain; make one with python -m motiongen_ardy.train.prompt_domain"
                )
            kinds = [file.get_slice(name).get_dtype() for name in ("mean", "directions")]
            if kinds != ["F32", "I8"]:  # the file may have types that numpy does not know
                raise DomainError(f"{path} holds numbers of the types {' and '.join(kinds)}; they must be F32 and I8")
            mean, levels = file.get_tensor("mean"), file.get_tensor("directions")
        threshold = float(metadata.get("threshold", ""))
    except DomainError:
        raise
    except OSError as error:
        raise DomainError(f"{path} cannot be read: {error.strerror or error}") from error
    except (SafetensorError, ValueError) as error:
        raise DomainError(f"{path} is no prompt domain: {error}") from error
    fits = levels.ndim == 2 and len(levels) and mean.shape == levels.shape[1:]
    if not fits or not np.isfinite(mean).all() or not math.isfinite(threshold):
        raise DomainError(f"{path} holds numbers of the wrong shape, or that are not finite")
    return PromptDomain(metadata.get("text_encoder", ""), mean, _from_levels(levels), threshold)


def _units(vectors: NDArray[np.float32]) -> Vectors:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), np.float32)


def _directions(vectors: Vectors, mean: Vectors) -> Vectors:
    return _units(_units(vectors) - mean)


def _levels(directions: Vectors) -> NDArray[np.int8]:
    """Each row scaled so that its largest absolute number is 127: only directions count."""
    largest = np.maximum(np.abs(directions).max(axis=1, keepdims=True), 1e-12)
    return np.round(directions / largest * _LEVELS).astype(np.int8)


def _from_levels(levels: NDArray[np.int8]) -> Vectors:
    return _units(levels.astype(np.float32))
