"""Broken checkpoint folders, made by hypothesis: bytes, configuration values, tensor headers."""

from __future__ import annotations

import copy
import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from hypothesis import strategies as st

from tests.ardy.conftest import GOLDEN

TINY = GOLDEN / "tiny-core27" / "checkpoint"
FILES = {str(path.relative_to(TINY)): path.read_bytes() for path in sorted(TINY.rglob("*")) if path.is_file()}
CONFIG = yaml.safe_load(FILES["config.yaml"])

SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(1 << 70), 1 << 70),
    st.sampled_from([0, 1, 2, 3, 4, 5, 7, 8, 16, 32, 64, 255, 256, 1 << 13, 1 << 31, 1 << 63]),
    st.floats(),
    st.text(max_size=20),
    st.sampled_from(
        ["/etc/passwd", "../../x", "${checkpoint_dir}/../x", "${oc.env:HOME}", "os.system", "ardy.model.Ardy", "stats",
         "builtins.eval", "FSQVAETransformer", "AETransformer", "SOMASkeleton30", "default", "\0", "~root", "a" * 2000]
    ),
)  # fmt: skip
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=8,
)


@st.composite
def broken_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """A file that is cut, lengthened, overwritten in places, or replaced altogether."""
    how = draw(st.sampled_from(["cut", "longer", "overwritten", "overwritten", "other", "header"]))
    if how == "cut":
        return content[: draw(st.integers(0, len(content)))]
    if how == "longer":
        return content + draw(st.binary(min_size=1, max_size=64))
    if how == "other":
        return draw(st.binary(max_size=256))
    if how == "header":
        return draw(st.integers(0, (1 << 64) - 1)).to_bytes(8, "little") + content[8:]
    changed = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        # headers are at the start, so half of the changes are made there
        last = draw(st.sampled_from([min(200, len(content)), len(content)])) - 1
        start = draw(st.integers(0, max(last, 0)))
        patch = draw(st.binary(min_size=1, max_size=8))
        changed[start : start + len(patch)] = patch
    return bytes(changed)


def places(content: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path to each value in nested mappings and lists."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [above, *(way for key, value in inner for way in places(value, (*above, key)))]


@st.composite
def broken_content(draw: st.DrawFn, content: Any) -> Any:
    """Nested mappings and lists with a few values replaced, removed or added."""
    changed = copy.deepcopy(content)
    for _ in range(draw(st.integers(1, 3))):
        way = draw(st.sampled_from(places(changed)))
        if not way:
            if draw(st.integers(0, 9)) == 0:
                return draw(VALUES)
            continue
        holder = changed
        for key in way[:-1]:
            holder = holder[key]
        action = draw(st.sampled_from(["replace", "replace", "remove", "add"]))
        if action == "remove":
            del holder[way[-1]]
        elif action == "add" and isinstance(holder, dict):
            holder[draw(st.text(max_size=12))] = draw(VALUES)
        else:
            holder[way[-1]] = draw(VALUES)
    return changed


def broken_config() -> st.SearchStrategy[bytes]:
    """The tiny model's configuration with values that do not belong there."""
    return broken_content(CONFIG).map(lambda content: yaml.safe_dump(content).encode())


def broken_tensor_file(name: str) -> st.SearchStrategy[bytes]:
    """A weights file with its bytes or its header changed; the data stays."""
    whole = FILES[name]
    (length,) = struct.unpack("<Q", whole[:8])
    header, data = json.loads(whole[8 : 8 + length]), whole[8 + length :]

    def with_header(changed: Any) -> bytes:
        text = json.dumps(changed).encode()
        return struct.pack("<Q", len(text)) + text + data

    return st.one_of(broken_bytes(whole), broken_content(header).map(with_header))


def broken_file(name: str) -> st.SearchStrategy[bytes]:
    if name == "config.yaml":
        return st.one_of(broken_config(), broken_bytes(FILES[name]))
    return broken_tensor_file(name) if name.endswith(".safetensors") else broken_bytes(FILES[name])


BROKEN_FOLDERS = st.dictionaries(st.sampled_from(list(FILES)), st.none(), min_size=1, max_size=3).flatmap(
    lambda names: st.fixed_dictionaries({name: st.one_of(st.none(), broken_file(name)) for name in names})
)
"""Changes to a valid folder: a file's name -> its broken content, None where it is missing."""


def write_folder(folder: Path, changes: dict[str, bytes | None]) -> Path:
    """Write the tiny model's folder with the changes."""
    for name, content in {**FILES, **changes}.items():
        if content is not None:
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return folder


def loads_or_refuses(load: Callable[[], Any], refusals: type[Exception] | tuple[type[Exception], ...]) -> str:
    """Return "loaded" or the text of the refusal; any other exception is a bug in the reader and is raised."""
    try:
        load()
    except refusals as refusal:
        text = str(refusal)
        assert 0 < len(text) < 100_000, f"a refusal of {len(text)} characters"
        return text
    return "loaded"
