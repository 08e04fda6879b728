"""The files of a checkpoint folder, read as untrusted input: inside the folder, bounded, and never executed."""

from __future__ import annotations

import json
import math
import stat
import struct
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

import torch
from safetensors import SafetensorError, safe_open
from torch import Tensor

from motiongen_ardy.core.problems import Problems

if TYPE_CHECKING:
    import yaml

MAX_CONFIG_BYTES = 64 << 10
MAX_CONFIG_NODES = 10_000
MAX_CONFIG_DEPTH = 32
MAX_CONFIG_CHARACTERS = 4 * MAX_CONFIG_BYTES
"""Of all texts and numbers in total, counted as often as anchors repeat them."""
MAX_INTEGER_CHARACTERS = 64
INTEGER_TAG = "tag:yaml.org,2002:int"
MAX_HEADER_BYTES = 1 << 20
WEIGHT_TYPES = {"F64": torch.float64, "F32": torch.float32, "F16": torch.float16, "BF16": torch.bfloat16}
OTHER_TYPES = {"BOOL": 1, "U8": 1, "I8": 1, "F8_E4M3": 1, "F8_E5M2": 1, "U16": 2, "I16": 2, "U32": 4, "I32": 4,
               "U64": 8, "I64": 8}  # fmt: skip
"""Bytes per number of types that weights cannot have, but that other tensors in the file may."""


class CheckpointError(Problems):
    """Raised for a folder that is not a complete, consistent checkpoint; it lists everything that is wrong."""


def path_inside(folder: Path, relative: str) -> Path:
    """The path of a file of the folder. Raises CheckpointError for one that leads out of it, by name or by link.

    In a cache of huggingface_hub, files are links into the repository's `blobs`; there, the whole repository counts.
    """
    if PurePosixPath(relative).is_absolute() or ".." in PurePosixPath(relative).parts or "\0" in relative:
        raise CheckpointError(
            f"the path {relative[:200]!r} leads out of the checkpoint folder; give one relative to it"
        )
    path, home = folder / relative, folder.resolve()
    if home.parent.name == "snapshots" and (home.parent.parent / "blobs").is_dir():
        home = home.parent.parent
    try:
        if not path.resolve().is_relative_to(home):
            raise CheckpointError(f"{path} is a link out of the checkpoint folder; put the file itself there")
    except (OSError, RuntimeError) as error:  # a link to itself
        raise CheckpointError(f"{path} cannot be followed: {error}") from error
    return path


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a regular file of at most `most` bytes. Raises CheckpointError for anything else."""
    size = file_size(path)
    if size > most:
        raise CheckpointError(f"{path} has {size} bytes; a file of that name is never larger than {most}")
    try:
        with path.open("rb") as file:
            return file.read(most + 1)
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error


def file_size(path: Path) -> int:
    """The size of a regular file in bytes. Raises CheckpointError if it is missing, or a folder, pipe or device."""
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise CheckpointError(f"{path} is missing; the checkpoint is not complete") from None
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(status.st_mode):
        raise CheckpointError(f"{path} is not a regular file")
    return status.st_size


# ---- YAML -----------------------------------------------------------------------------------------------------------


def read_yaml(path: Path) -> object:
    """The content of a YAML file: mappings, lists and scalars. Anchors are allowed, tags other than YAML's own are not.

    Raises CheckpointError for what is not YAML, for duplicate keys and keys that are not scalars, for a file that
    exceeds MAX_CONFIG_NODES or MAX_CONFIG_CHARACTERS when its anchors are followed, or that contains itself, for whole
    numbers of more than MAX_INTEGER_CHARACTERS, and for halves of surrogate pairs, which no text can hold.
    """
    return parse_yaml(read_bytes(path, MAX_CONFIG_BYTES), path)


def parse_yaml(text: str | bytes, path: Path) -> object:
    """The content of YAML from a file. Raises CheckpointError as `read_yaml` does, and above MAX_CONFIG_BYTES."""
    import yaml

    if len(text) > MAX_CONFIG_BYTES:
        raise CheckpointError(f"{path} has {len(text)} bytes of YAML; at most {MAX_CONFIG_BYTES} are read")
    try:
        loader = yaml.SafeLoader(text)
        try:
            root = loader.get_single_node()
            if root is None:
                raise CheckpointError(f"{path} is empty; it must hold named values")
            _check_nodes(root, path)
            return loader.construct_document(root)
        finally:
            loader.dispose()
    except CheckpointError:
        raise
    except RecursionError as error:
        raise CheckpointError(f"{path} is nested too deeply; a configuration has a few levels") from error
    except (yaml.YAMLError, ValueError, OverflowError, AttributeError, TypeError) as error:
        # besides YAMLError: what PyYAML's own constructors raise for malformed numbers, dates and sets
        raise CheckpointError(f"{path} is not readable YAML: {str(error)[:500]}") from error


def _check_nodes(root: yaml.Node, path: Path) -> None:
    """Count nodes and characters as often as anchors repeat them, before anything is built from them."""
    from yaml import MappingNode, ScalarNode, SequenceNode

    nodes, characters = MAX_CONFIG_NODES, MAX_CONFIG_CHARACTERS
    pending: list[tuple[yaml.Node, int]] = [(root, 1)]
    while pending:
        node, depth = pending.pop()
        nodes -= 1
        characters -= len(node.value) if isinstance(node, ScalarNode) else 0
        if nodes < 0 or characters < 0 or depth > MAX_CONFIG_DEPTH:
            raise CheckpointError(
                f"{path} is too large when its anchors are followed (more than {MAX_CONFIG_NODES} entries, "
                f"{MAX_CONFIG_CHARACTERS} characters or {MAX_CONFIG_DEPTH} levels); that is no configuration"
            )
        if isinstance(node, ScalarNode):
            _check_scalar(node, path)
        elif isinstance(node, SequenceNode):
            pending += [(child, depth + 1) for child in node.value]
        elif isinstance(node, MappingNode):
            _check_keys([key for key, _ in node.value], path)
            pending += [(child, depth + 1) for pair in node.value for child in pair]


def _check_keys(keys: Sequence[yaml.Node], path: Path) -> None:
    """Raise CheckpointError for keys that are not scalars, or duplicate, before anchors in them expand enormously."""
    from yaml import ScalarNode

    if not all(isinstance(key, ScalarNode) for key in keys):
        raise CheckpointError(f"{path} has a list or a mapping as a key; keys are words")
    counted = Counter(str(key.value) for key in keys)
    twice = sorted(key[:60] for key, count in counted.items() if count > 1)
    if twice:
        raise CheckpointError(f"{path} gives the keys {', '.join(map(repr, twice))} twice in one mapping")


def _check_scalar(node: yaml.ScalarNode, path: Path) -> None:
    """Raise CheckpointError for a value that Python can read but neither write nor send."""
    if node.tag == INTEGER_TAG and len(node.value) > MAX_INTEGER_CHARACTERS:
        raise CheckpointError(
            f"{path} has a whole number of {len(node.value)} characters, {node.value[:20]}...; "
            f"at most {MAX_INTEGER_CHARACTERS} are read"
        )
    try:
        node.value.encode()
    except UnicodeEncodeError as error:
        raise CheckpointError(
            f"{path} has a text with half of a surrogate pair, {node.value[error.start]!r}; write the character itself"
        ) from error


# ---- safetensors ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TensorEntry:
    """One tensor of a safetensors header: its type as written there, its shape, and its byte range."""

    dtype: str
    shape: tuple[int, ...]
    start: int
    end: int


class TensorFile:
    """A safetensors file whose header has been checked against the file's size; tensors are read one at a time."""

    def __init__(self, path: Path) -> None:
        """Raises CheckpointError listing everything that is wrong with the header."""
        self.path = path
        size = file_size(path)
        try:
            with path.open("rb") as file:
                length_bytes = file.read(8)
                length = struct.unpack("<Q", length_bytes)[0] if len(length_bytes) == 8 else 0
                if not 2 <= length <= min(MAX_HEADER_BYTES, size - 8):
                    raise CheckpointError(
                        f"{path} is not a safetensors file: it claims a header of {length} bytes and has {size} in all"
                    )
                header = file.read(length)
        except OSError as error:
            raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error
        self.entries = self._parse(header, size - 8 - length)

    def _parse(self, header: bytes, data_bytes: int) -> dict[str, TensorEntry]:
        try:
            listed = json.loads(header, object_pairs_hook=_refuse_twice)
        except (ValueError, RecursionError) as error:
            raise CheckpointError(
                f"{self.path} is not a safetensors file: its header is not JSON ({str(error)[:200]})"
            ) from error
        if not isinstance(listed, dict):
            raise CheckpointError(f"{self.path} is not a safetensors file: its header is no JSON object")
        listed.pop("__metadata__", None)
        problems: list[str] = []
        entries: dict[str, TensorEntry] = {}
        for name, fields in listed.items():
            entry = _tensor_entry(fields)
            if isinstance(entry, str):
                problems.append(f"{name[:200]!r} {entry}")
            else:
                entries[name] = entry
        problems += [] if problems else _range_problems(entries, data_bytes)
        if problems:
            raise CheckpointError([f"{self.path}: {problem}" for problem in problems])
        return entries

    def require_weights(self, names: Iterable[str]) -> None:
        """Raise CheckpointError if any of the named tensors has a type that weights cannot have."""
        odd = [name for name in names if self.entries[name].dtype not in WEIGHT_TYPES]
        if odd:
            allowed = f"weights must be one of {', '.join(WEIGHT_TYPES)}"
            raise CheckpointError(
                [f"{self.path}: {name[:200]!r} has the type {self.entries[name].dtype!r}; {allowed}" for name in odd]
            )

    def read(self, wanted: Mapping[str, torch.dtype]) -> dict[str, Tensor]:
        """The named tensors, each in the given floating-point type. Raises CheckpointError if the file has shrunk."""
        tensors: dict[str, Tensor] = {}
        try:
            with safe_open(self.path, "pt") as file:
                for name, dtype in sorted(wanted.items(), key=lambda item: self.entries[item[0]].start):
                    # A copy in torch's own memory: aligned as products need it, and so that they always round alike.
                    tensors[name] = file.get_tensor(name).clone().to(dtype)
        except (OSError, SafetensorError) as error:
            raise CheckpointError(f"{self.path} cannot be read, it may have changed meanwhile: {error}") from error
        return tensors


def _refuse_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) != len(pairs):
        raise ValueError("a name is given twice")
    return mapping


def _tensor_entry(fields: object) -> TensorEntry | str:
    """The entry, or what is wrong with it."""
    if not isinstance(fields, dict) or fields.keys() != {"dtype", "shape", "data_offsets"}:
        return "is not described by dtype, shape and data_offsets"
    dtype, shape, offsets = fields["dtype"], fields["shape"], fields["data_offsets"]
    if not isinstance(dtype, str) or dtype not in WEIGHT_TYPES.keys() | OTHER_TYPES.keys():
        return f"has the type {str(dtype)[:40]!r}; weights must be one of {', '.join(WEIGHT_TYPES)}"
    if not _counts(shape) or len(shape) > 8:
        return f"has the shape {str(shape)[:80]}"
    if not _counts(offsets) or len(offsets) != 2:
        return f"has the data_offsets {str(offsets)[:80]}"
    needed = math.prod(shape) * (OTHER_TYPES[dtype] if dtype in OTHER_TYPES else WEIGHT_TYPES[dtype].itemsize)
    if offsets[1] - offsets[0] != needed:
        return f"lies in bytes {offsets[0]} to {offsets[1]}, but {dtype} {tuple(shape)} takes {needed}"
    return TensorEntry(dtype, tuple(shape), offsets[0], offsets[1])


def _counts(value: object) -> bool:
    return isinstance(value, list) and all(type(number) is int and 0 <= number < 1 << 62 for number in value)


def _range_problems(entries: Mapping[str, TensorEntry], data_bytes: int) -> list[str]:
    """Check that the tensors fill the data without overlap or gap, as the format demands."""
    problems = []
    position = 0
    for name, entry in sorted(entries.items(), key=lambda item: (item[1].start, item[1].end)):
        if entry.start != position:
            kind = "overlaps the tensor before it" if entry.start < position else "leaves a gap before it"
            problems.append(f"{name[:200]!r} in bytes {entry.start} to {entry.end} {kind} (expected {position})")
        position = max(position, entry.end)
    if position != data_bytes and not problems:
        problems.append(f"its tensors take {position} bytes, but {data_bytes} follow the header; it is cut or too long")
    return problems
