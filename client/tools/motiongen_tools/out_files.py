"""Where a command writes what it was given: names by format and by sample, checked before the work."""

from __future__ import annotations

import argparse
from pathlib import Path

from motiongen_tools.arguments import check_file_to_write

# Longer ends first: the first that fits decides.
SUFFIXES = (".controller.csv", ".csv", ".npz", ".bvh", ".glb", ".json")
MOST_CHECKED = 1000  # how many samples there may be the server says, and any number can be asked for


def out_path(text: str) -> Path:
    """Raises ArgumentTypeError, which argparse prints, for a name that tells no format."""
    path = Path(text)
    if not suffix_of(path) or not path.name.removesuffix(suffix_of(path)):
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a name that ends in {', '.join(SUFFIXES)}")
    return path


def motion_path(text: str) -> Path:
    """The same of motion alone: JSON has none."""
    path = out_path(text)
    if suffix_of(path) == ".json":
        motion = ", ".join(suffix for suffix in SUFFIXES if suffix != ".json")
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a name that ends in {motion}")
    return path


def check_out(out: Path, num_samples: int) -> None:
    """Find out before the work whether files can be written; makes their folder. Raises InvalidInput."""
    paths = [out] if out.name.endswith(".json") else sample_paths(out, min(num_samples, MOST_CHECKED))
    for path in paths:
        check_file_to_write("--out", path)


def sample_paths(path: Path, num_samples: int) -> list[Path]:
    """Where samples go, as ARDY's command line has it: walk.npz alone, else walk/walk_00.npz and so on."""
    if num_samples == 1:
        return [path]
    suffix = suffix_of(path)
    stem = path.name.removesuffix(suffix)
    return [path.parent / stem / f"{stem}_{index:02d}{suffix}" for index in range(num_samples)]


def suffix_of(path: Path) -> str:
    """The end of the name that tells the format; none where it tells nothing."""
    return next((suffix for suffix in SUFFIXES if path.name.endswith(suffix)), "")


def is_without_clock(path: Path) -> bool:
    """Whether its rows a second have to be said: of a robot's qpos alone."""
    return path.name.lower().endswith(".csv") and not path.name.lower().endswith(".controller.csv")
