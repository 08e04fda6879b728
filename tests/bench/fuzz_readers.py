"""`python -m tests.bench.fuzz_readers`: every reader of foreign files meets thousands of broken ones.

A case passes when the file is read or refused with the reader's own error; any other exception is a failure, which
hypothesis then shrinks and prints. `--cases` are shared among the readers; `--seed` makes a run repeatable.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from ardy.checkpoint import CheckpointError, load_checkpoint
from ardy.checkpoint_config import read_model_config
from ardy.checkpoint_files import TensorFile, read_yaml
from ardy.config import ConfigError
from ardy.formats.constraints import read_constraints
from ardy.formats.errors import FormatError
from ardy.formats.files import read_motion, write_motion
from ardy.formats.root_path import read_root_path
from ardy.npy import NpyError, read_npy
from ardy.skeleton import load_skeleton
from tests.ardy.broken_checkpoints import (
    BROKEN_FOLDERS,
    broken_bytes,
    broken_content,
    broken_file,
    loads_or_refuses,
    write_folder,
)
from tests.ardy.formats.motions import random_motion

CONSTRAINTS: list[Any] = [
    {"type": "root2d", "frame_indices": [3, 7], "root_2d": [[0.0, 1.0], [1.0, 2.0]], "global_root_heading": [0.0, 1.5]},
    {"type": "fullbody", "frame_indices": [5], "local_joints_rot": [[[0.0, 0.1, 0.0]] * 27],
     "root_positions": [[0.0, 0.9, 0.0]]},
]  # fmt: skip
ROOT_PATH = {"type": "keyframes", "keyframes": {"0": [0.0, 0.0, 0.0], "12": [0.5, 0.0, 1.0]}}


@dataclass(frozen=True)
class Reader:
    """What reads: given broken content and a path to write it to. share: of the cases, as it is slow or quick."""

    name: str
    broken: st.SearchStrategy[Any]
    read: Callable[[Any, Path], object]
    refusals: tuple[type[Exception], ...]
    share: float = 1.0


def from_file(read: Callable[[Path], object]) -> Callable[[bytes, Path], object]:
    """A reader of a path, for content that is written there first."""

    def write_and_read(content: bytes, path: Path) -> object:
        path.write_bytes(content)
        return read(path)

    return write_and_read


def broken_json(content: Any) -> st.SearchStrategy[bytes]:
    """JSON of wrong values, and text that is hardly JSON any more."""
    return st.one_of(
        broken_content(content).map(lambda changed: json.dumps(changed).encode()),
        broken_bytes(json.dumps(content).encode()),
    )


def checkpoint_readers() -> list[Reader]:
    return [
        Reader("checkpoint folder", BROKEN_FOLDERS, lambda changes, path: load_checkpoint(write_folder(path, changes)),
               (CheckpointError,), share=0.5),
        Reader("config.yaml", broken_file("config.yaml"), from_file(lambda path: read_model_config(read_yaml(path))),
               (CheckpointError, ConfigError), share=2.0),
        Reader("safetensors header", broken_file("tokenizer.safetensors"), from_file(TensorFile), (CheckpointError,)),
        Reader("npy", broken_file("stats/motion/mean.npy"), lambda content, _: read_npy(content), (NpyError,)),
    ]  # fmt: skip


def format_readers(folder: Path) -> list[Reader]:
    """The readers of motion, constraints and paths; sound files to break are written into the folder."""
    people, robot = load_skeleton("core27"), load_skeleton("g134")
    readers = [
        Reader("constraint JSON", broken_json(CONSTRAINTS), from_file(lambda path: read_constraints(path, people)),
               (FormatError,)),
        Reader("root path JSON", broken_json(ROOT_PATH), from_file(read_root_path), (FormatError,)),
    ]  # fmt: skip
    for name, skeleton in (("npz", people), ("bvh", people), ("g1-csv", robot), ("g1-controller-csv", robot)):
        sound = folder / f"sound.{name}"
        write_motion(sound, random_motion(skeleton, 8, seed=1), name=name)
        read = from_file(lambda path, name=name: read_motion(path, name=name))
        readers.append(Reader(name, broken_bytes(sound.read_bytes()), read, (FormatError,), share=0.5))
    return readers


def fuzz(reader: Reader, num_cases: int, start: int) -> tuple[int, int]:
    """Run the cases; returns how many were read and how many refused. Any other outcome raises."""
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
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=10_000, help="broken files in all (default %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="of the first reader (default %(default)s)")
    parser.add_argument("--only", help="readers whose name holds this")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        readers = [one for one in [*checkpoint_readers(), *format_readers(Path(folder))]
                   if (arguments.only or "") in one.name]  # fmt: skip
    shares = sum(one.share for one in readers)
    print(f"{'reader':<22}{'cases':>8}{'read':>8}{'refused':>9}{'seconds':>9}")
    total = 0
    for index, reader in enumerate(readers):
        begun = time.perf_counter()
        read, refused = fuzz(reader, round(arguments.cases * reader.share / shares), arguments.seed + index)
        total += read + refused
        print(f"{reader.name:<22}{read + refused:>8}{read:>8}{refused:>9}{time.perf_counter() - begun:>9.1f}")
    print(f"{total} broken files: every one was read or refused with the reader's own error")


if __name__ == "__main__":
    main()
