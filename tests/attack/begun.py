"""How a hostile client reports that it has reached the server; the process that started it waits for that."""

from __future__ import annotations

import sys

_said: list[str] = []


def begun() -> None:
    """Report it, the first time that this is called."""
    if not _said:
        _said.append("begun")
        print(*_said, file=sys.stdout, flush=True)


def has_begun() -> bool:
    """Whether it has been reported."""
    return bool(_said)
