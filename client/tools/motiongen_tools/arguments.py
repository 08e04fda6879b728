"""Values of the command line that several commands take."""

from __future__ import annotations

import argparse
import math


def number_above_zero(text: str) -> float:
    """Raises ArgumentTypeError, which argparse prints."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number) or number <= 0:
        raise argparse.ArgumentTypeError(f"{text!r} was given; allowed is a number above 0")
    return number
