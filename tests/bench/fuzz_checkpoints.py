"""`python -m tests.bench.fuzz_checkpoints`: give the readers of checkpoint folders thousands of broken files.

A case passes if the file is read or refused with the reader's own error; any other exception is a failure, which
hypothesis then shrinks and prints. `--cases` are divided among the readers; `--seed` makes a run repeatable.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_ardy.checkpoint.config import read_model_config
from motiongen_ardy.checkpoint.files import CheckpointError, TensorFile, read_yaml
from motiongen_ardy.checkpoint.npy import NpyError, read_npy
from motiongen_ardy.model.config import ConfigError
from tests.ardy.broken_checkpoints import (
    BROKEN_FOLDERS,
    broken_file,
    loads_or_refuses,
    write_folder,
)


@dataclass(frozen=True)
class Reader:
    """A reader, called with broken content and a path to write it to. share: of the cases, less for slow readers."""

    name: str
    broken: st.SearchStrategy[Any]
    read: Callable[[Any, Path], object]
    refusals: tuple[type[Exception], ...]
    share: float = 1.0


def from_file(read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """Turn a reader of a path into one of content, which is written there first."""

    def write_and_read(content: bytes, path: Path) -> object:
        path.write_bytes(content)
        return read(path)

    return write_and_read


def checkpoint_readers() -> list[Reader]:
    return [
        Reader("checkpoint folder", BROKEN_FOLDERS, lambda changes, path: load_checkpoint(write_folder(path, changes)),
               (CheckpointError,), share=0.5),
        Reader("config.yaml", broken_file("config.yaml"), from_file(lambda path: read_model_config(read_yaml(path))),
               (CheckpointError, ConfigError), share=2.0),
        Reader("safetensors header", broken_file("tokenizer.safetensors"), from_file(TensorFile), (CheckpointError,)),
        Reader("npy", broken_file("stats/motion/mean.npy"), lambda content, _: read_npy(content), (NpyError,)),
    ]  # fmt: skip


def fuzz(reader: Reader, num_cases: int, start: int) -> tuple[int, int]:
    """Run the cases; returns how many were read and how many were refused. Any other outcome raises."""
    counts = {"read": 0, "refused": 0}

    @seed(start)
    @settings(max_examples=num_cases, deadline=None, database=None, suppress_health_check=list(HealthCheck),
              phases=(Phase.generate, Phase.shrink))  # fmt: skip
    @given(reader.broken)
    def case(content: Any) -> None:
        with tempfile.TemporaryDirectory() as folder:
            outcome = loads_or_refuses(lambda: reader.read(content, Path(folder) / "given"), reader.refusals)
        counts["read" if outcome == "loaded" else "refused"] += 1

    case()
    return counts["read"], counts["refused"]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.fuzz_checkpoints", description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000, help="broken files in all (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first reader (default %(default)s)")
    parser.add_argument("--only", help="only readers whose name contains this")
    arguments = parser.parse_args()
    readers = [one for one in checkpoint_readers() if (arguments.only or "") in one.name]
    shares = sum(one.share for one in readers)
    print(f"{'reader':<22}{'cases':>8}{'read':>8}{'refused':>9}{'seconds':>9}")
    total = 0
    for index, reader in enumerate(readers):
        begun = time.perf_counter()
        read, refused = fuzz(reader, math.ceil(arguments.cases * reader.share / shares), arguments.seed + index)
        total += read + refused
        print(f"{reader.name:<22}{read + refused:>8}{read:>8}{refused:>9}{time.perf_counter() - begun:>9.1f}")
    print(f"{total} broken files: every one was read or refused with the reader's own error")


if __name__ == "__main__":
    main()
