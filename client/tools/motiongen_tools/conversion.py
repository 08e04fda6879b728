"""Other motion files, by the converter of motiongen-ardy: `python -m motiongen_ardy.formats`.

It is another distribution and is run, never imported.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from motiongen_client.errors import MotiongenError


class ConversionFailed(MotiongenError):
    """The converter is not installed, or could not read or write a file; the message says which and why."""


def convert_file(source: Path, target: Path, *options: str) -> list[str]:
    """Convert a motion file to what the target's name says; returns what could not be kept, or had to change."""
    command = [sys.executable, "-m", "motiongen_ardy.formats", *options, str(source), str(target)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode == 0:
        return [line.strip() for line in done.stdout.splitlines()[1:]]
    said = done.stderr.strip().splitlines()
    reason = said[-1].removeprefix("error: ") if said else f"exit code {done.returncode}"
    if "No module named" in reason:
        reason = "it is not installed here: install motiongen-ardy, or write .npz or .bvh, which need none"
    raise ConversionFailed(f"{target.name}: the converter failed: {reason}")
