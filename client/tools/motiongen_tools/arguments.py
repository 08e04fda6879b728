"""Argument types and checks that several commands share."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

from motiongen_client.errors import InvalidInput


def number_above_zero(text: str) -> float:
    """A number above zero. Raises ArgumentTypeError, which argparse prints."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number above 0")
    return number


def add_start_timeout(parser: argparse.ArgumentParser) -> None:
    """Add the option of commands that may start a server."""
    parser.add_argument(
        "--start-timeout",
        type=number_above_zero,
        metavar="SECONDS",
        help="end the server that this starts if it is not ready by then (default: wait as long as it runs; the first "
        "start of a model may have gigabytes to fetch)",
    )


def check_file_to_read(option: str, path: Path) -> None:
    """Check before the work that a file can be read. Raises InvalidInput."""
    try:
        path.open("rb").close()
    except OSError as error:
        raise InvalidInput(option, str(path), f"a file that can be read ({error.strerror})") from None


def check_file_to_write(option: str, path: Path) -> None:
    """Check before the work that a file can be written; creates its folder. Raises InvalidInput."""
    check_folder_to_write(option, path.parent)
    if path.is_dir() or (path.exists() and not os.access(path, os.W_OK)):
        raise InvalidInput(option, str(path), "a file that can be written")


def check_folder_to_write(option: str, folder: Path) -> None:
    """Check before the work that a folder can be written to; creates it. Raises InvalidInput."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        allowed = f"a folder that can be made and written ({error.strerror})"
        raise InvalidInput(option, str(folder), allowed) from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InvalidInput(option, str(folder), "a folder that can be written")
