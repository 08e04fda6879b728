"""Conversion to further motion formats, by `python -m motiongen_ardy.formats`.

The converter belongs to another distribution, motiongen-ardy; it is run, never imported.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from motiongen_client.errors import MotiongenError
from motiongen_tools.whole_file import whole_file


class ConversionFailed(MotiongenError):
    """The converter is not installed, or could not read or write a file. The message says which and why."""


def convert_file(source: Path, target: Path, *options: str) -> list[str]:
    """Convert a motion file to the format of the target's name; returns what could not be kept or had to change.

    Raises ConversionFailed, and OSError if the target's folder cannot be written to.
    """
    with whole_file(target) as part:
        # absolute paths, because a name that begins with a dash would be read as an option
        files = (str(source.absolute()), str(part))
        command = [sys.executable, "-m", "motiongen_ardy.formats", *options, *files]
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode != 0:
            said = done.stderr.strip().splitlines()
            reason = said[-1].removeprefix("error: ") if said else f"exit code {done.returncode}"
            if "No module named" in reason:
                reason = "it is not installed here: install motiongen-ardy, or write .npz or .bvh, which do not need it"
            raise ConversionFailed(f"{target.name}: the converter failed: {reason.replace(str(part), str(target))}")
    return [line.strip() for line in done.stdout.splitlines()[1:]]
