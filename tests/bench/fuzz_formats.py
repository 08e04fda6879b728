"""`python -m tests.bench.fuzz_formats`: give the readers of motion, constraints and paths 10,000 damaged files."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.ardy.formats.mutations import Reader, readers
from tests.ardy.formats.refusal import read_or_refuse


def fuzz(reader: Reader, path: Path, num_cases: int, first: int) -> Counter[bool]:
    """How many files were read (True) and refused (False). Any other outcome raises, with the smallest such file."""
    counts: Counter[bool] = Counter()

    @seed(first)
    @settings(
        max_examples=num_cases,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(content=reader.files())
    def check(content: bytes) -> None:
        counts[read_or_refuse(reader, path, content)] += 1

    check()
    return counts


def main(argv: list[str] | None = None) -> int:
    arguments = argparse.ArgumentParser(prog="python -m tests.bench.fuzz_formats", description=__doc__)
    arguments.add_argument("--cases", type=int, default=10_000, help="total number of files (default: %(default)s)")
    arguments.add_argument("--seed", type=int, default=0, help="seed of the cases (default: %(default)s)")
    arguments.add_argument("--reader", help="run only the reader with this name")
    asked = arguments.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [reader for reader in readers(folder) if asked.reader in (None, reader.name)]
        if not chosen:
            names = ", ".join(reader.name for reader in readers(folder))
            arguments.error(f"no reader {asked.reader!r}; there are {names}")
        for reader in chosen:
            start = time.monotonic()
            counts = fuzz(reader, folder / "file", asked.cases // len(chosen), asked.seed)
            took = time.monotonic() - start
            print(f"{reader.name:18} {counts[True]:6} read {counts[False]:6} refused {took:6.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
