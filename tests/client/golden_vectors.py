"""Golden vectors that keep the Python and the C++ client equal: `python -m tests.client.golden_vectors` writes them.

A file consists of lines, each a name and numbers (or bytes in hex), and after `->` the results. The Python client makes
them; tests/client/test_golden_vectors.py and client/cpp/tests/core compare both clients with the files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.client.golden.formats import frame_formats
from tests.client.golden.ground import ground
from tests.client.golden.playback import sampling
from tests.client.golden.retarget import retarget
from tests.client.golden.steering import axes, steering

FOLDER = Path(__file__).resolve().parents[1] / "data" / "client"

FILES: dict[str, Callable[[], Iterator[str]]] = {
    "sampling": sampling,
    "axes": axes,
    "steering": steering,
    "frame_formats": frame_formats,
    "retarget": retarget,
    "ground": ground,
}


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, lines in FILES.items():
        (FOLDER / f"{name}.txt").write_text("\n".join(lines()) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
