"""Argument types and checks that several commands share."""

from __future__ import annotations

import argparse
import math
import os
from collections.abc import Callable
from pathlib import Path

from motiongen_client.errors import InvalidInput

MOST_SEED = (1 << 64) - 1
_MOST_DIGITS = 100  # Python itself refuses to read thousands


def number_above_zero(text: str) -> float:
    """A number above zero. Raises ArgumentTypeError, which argparse prints."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number above 0")
    return number


def whole_number(least: int, most: float = math.inf) -> Callable[[str], int]:
    """An argparse type: whole numbers from `least` to `most`."""
    allowed = f"of {least} or more" + (f", up to {most:,.0f}" if math.isfinite(most) else "")

    def parse(text: str) -> int:
        plain = text.isascii() and text.isdigit() and len(text) <= _MOST_DIGITS
        if not plain or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a whole number {allowed}")
        return int(text)

    return parse


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
    """Check before the work that a file can be written; its folder may be missing. Raises InvalidInput."""
    check_folder_to_write(option, path.parent)
    if path.is_dir() or (path.exists() and not os.access(path, os.W_OK)):
        raise InvalidInput(option, str(path), "a file that can be written")


def check_folder_to_write(option: str, folder: Path) -> None:
    """Check before the work that a folder can be written to, or can be created. Raises InvalidInput.

    It is not created yet, so that work that fails leaves no empty folder behind.
    """
    existing = next(path for path in (folder.absolute(), *folder.absolute().parents) if os.path.lexists(path))
    if not existing.is_dir():
        raise InvalidInput(option, str(folder), f"a folder: {existing} is not one")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InvalidInput(option, str(folder), f"a folder that can be written: {existing} cannot be")
