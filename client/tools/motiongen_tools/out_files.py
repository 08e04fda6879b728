"""Output files of commands: names by format and sample, checked before the work."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from motiongen_tools.arguments import check_file_to_write

# Longer suffixes first: the first that matches decides.
SUFFIXES = (".controller.csv", ".csv", ".npz", ".bvh", ".glb", ".json")
MOST_CHECKED = 1000  # any number of samples can be asked for: the limit is the server's


def out_path(text: str) -> Path:
    """A path whose name ends in a known format. Raises ArgumentTypeError, which argparse prints."""
    return _path_in(text, SUFFIXES)


def motion_path(text: str) -> Path:
    """As out_path, for formats that hold motion, so not JSON."""
    return _path_in(text, [suffix for suffix in SUFFIXES if suffix != ".json"])


def page_path(text: str) -> Path:
    """As out_path, for a web page."""
    return _path_in(text, (".html",))


def _path_in(text: str, suffixes: Sequence[str]) -> Path:
    path = Path(text)
    suffix = next((known for known in suffixes if path.name.endswith(known)), "")
    if not path.name.removesuffix(suffix) or not suffix:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a name that ends in {', '.join(suffixes)}")
    return path


def check_out(out: Path, num_samples: int) -> None:
    """Check before the work that the files can be written; creates their folder. Raises InvalidInput."""
    paths = [out] if out.name.endswith(".json") else sample_paths(out, min(num_samples, MOST_CHECKED))
    for path in paths:
        check_file_to_write("--out", path)


def sample_paths(path: Path, num_samples: int) -> list[Path]:
    """The files of the samples, named as by ARDY's command line: walk.npz for one, else walk/walk_00.npz and so on."""
    if num_samples == 1:
        return [path]
    suffix = suffix_of(path)
    stem = path.name.removesuffix(suffix)
    return [path.parent / stem / f"{stem}_{index:02d}{suffix}" for index in range(num_samples)]


def suffix_of(path: Path) -> str:
    """The suffix of the name that determines the format; "" if there is none."""
    return next((suffix for suffix in SUFFIXES if path.name.endswith(suffix)), "")


def is_without_clock(path: Path) -> bool:
    """Whether the file does not record its frame rate: a CSV with only the qpos of a robot."""
    return path.name.lower().endswith(".csv") and not path.name.lower().endswith(".controller.csv")
