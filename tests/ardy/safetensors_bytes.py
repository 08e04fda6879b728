"""safetensors files of any types, including those that numpy lacks and the numpy writer refuses."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any


def safetensors_of(tensors: Mapping[str, tuple[str, Sequence[int], bytes]], metadata: Mapping[str, str]) -> bytes:
    """The file's content. tensors: by name, the type as the format writes it, the shape, the bytes."""
    header: dict[str, Any] = {"__metadata__": dict(metadata)}
    data = b""
    for name, (dtype, shape, content) in tensors.items():
        header[name] = {"dtype": dtype, "shape": list(shape), "data_offsets": [len(data), len(data) + len(content)]}
        data += content
    written = json.dumps(header).encode()
    return len(written).to_bytes(8, "little") + written + data
