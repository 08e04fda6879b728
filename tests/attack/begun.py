"""What a hostile client says once it has reached the server: whoever has started it waits for that."""

from __future__ import annotations

import sys

_said: list[str] = []


def begun() -> None:
    """Say it, the first time."""
    if not _said:
        _said.append("begun")
        print(*_said, file=sys.stdout, flush=True)


def has_begun() -> bool:
    """Whether it has been said."""
    return bool(_said)
