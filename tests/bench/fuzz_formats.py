"""`python -m tests.bench.fuzz_formats`: 10,000 damaged files for the readers of motion, constraints and paths."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.ardy.formats.mutations import readers
from tests.ardy.formats.refusal import read_or_refuse


def main(argv: list[str] | None = None) -> int:
    arguments = argparse.ArgumentParser(prog="python -m tests.bench.fuzz_formats", description=__doc__)
    arguments.add_argument("--cases", type=int, default=10_000, help="files in all (%(default)s)")
    arguments.add_argument("--seed", type=int, default=0, help="of the cases (%(default)s)")
    arguments.add_argument("--reader", help="only this one, by its name")
    asked = arguments.parse_args(argv)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        chosen = [reader for reader in readers(folder) if asked.reader in (None, reader.name)]
        if not chosen:
            names = ", ".join(reader.name for reader in readers(folder))
            arguments.error(f"no reader {asked.reader!r}; there are {names}")
        for reader in chosen:
            counts: Counter[str] = Counter()
            start = time.monotonic()

            @seed(asked.seed)
            @settings(
                max_examples=asked.cases // len(chosen),
                deadline=None,
                database=None,
                phases=[Phase.generate, Phase.shrink],
                suppress_health_check=list(HealthCheck),
            )
            @given(content=reader.files())
            def check(content: bytes, reader=reader, counts=counts) -> None:  # type: ignore[no-untyped-def]
                counts["read" if read_or_refuse(reader, folder / "file", content) else "refused"] += 1

            check()
            took = time.monotonic() - start
            print(f"{reader.name:18} {counts['read']:6} read {counts['refused']:6} refused {took:6.1f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
