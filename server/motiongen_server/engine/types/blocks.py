"""The blocks that a frame row consists of."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ChannelBlock:
    """A named group of consecutive floats in a frame row, such as ("root_translation_m", 3)."""

    name: str
    width: int
