"""Conversion to further motion formats, by `python -m motiongen_ardy.formats`.

The converter belongs to another distribution, motiongen-ardy; it is run, never imported.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from motiongen_client.errors import MotiongenError
from motiongen_tools.whole_file import whole_file


class ConversionFailed(MotiongenError):
    """The converter is not installed, or could not read or write a file. The message says which and why."""


def convert_file(source: Path, target: Path, *options: str, source_name: str | None = None) -> list[str]:
    """Convert a motion file to the format of the target's name; returns what could not be kept or had to change.

    source_name: what messages call the source, if it is a temporary file. Raises ConversionFailed, and OSError if the
    target's folder cannot be written to.
    """
    with whole_file(target) as part:
        done = _run(source, part, options)
        if done.returncode != 0:
            reason = _reason(done, source, source_name).replace(str(part), str(target))
            raise ConversionFailed(f"{target.name}: the converter failed: {reason}")
    return [line.strip() for line in done.stdout.splitlines()[1:]]


def convert_to_npz(source: Path, npz: Path, *options: str, source_name: str | None = None) -> None:
    """Convert a motion file of any format to ARDY's NPZ, as a temporary file to be read at once.

    As convert_file, but what is raised names the source alone.
    """
    done = _run(source, npz, options)
    if done.returncode != 0:
        name = source_name or str(source)
        reason = _reason(done, source, source_name)
        raise ConversionFailed(reason if reason.startswith(f"{name}: ") else f"{name}: the converter failed: {reason}")


def _run(source: Path, target: Path, options: Sequence[str]) -> subprocess.CompletedProcess[str]:
    # absolute paths, because a name that begins with a dash would be read as an option
    files = (str(source.absolute()), str(target.absolute()))
    command = [sys.executable, "-m", "motiongen_ardy.formats", *options, *files]
    return subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)


def _reason(done: subprocess.CompletedProcess[str], source: Path, source_name: str | None) -> str:
    said = done.stderr.strip().splitlines()
    reason = said[-1].removeprefix("error: ") if said else f"exit code {done.returncode}"
    if "No module named" in reason:
        return "it is not installed here: install motiongen-ardy; .npz and .bvh can be written without it"
    return reason.replace(str(source.absolute()), source_name or str(source))
