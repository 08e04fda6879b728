"""Compare reports side by side: `python -m motiongen_ardy.evaluate.beside NAME=REPORT.json ... [--into PAGE.md]`."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from motiongen_ardy.core.output import command
from motiongen_ardy.evaluate.report import ReportError, put_between_marks, read_report, side_by_side


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m motiongen_ardy.evaluate.beside", description=__doc__)
    parser.add_argument("reports", nargs="+", metavar="NAME=FILE", help="a column's heading and its JSON file")
    parser.add_argument("--into", type=Path, help="a Markdown page whose table between the marks is replaced")
    arguments = parser.parse_args()
    named = [report.partition("=") for report in arguments.reports]
    if not all(name and path for name, _, path in named):
        parser.error("give every report as NAME=FILE")
    try:
        text = side_by_side({name: read_report(Path(path)) for name, _, path in named})
        if arguments.into is None:
            print(text)
        else:
            put_between_marks(arguments.into, text)
    except (ReportError, OSError) as error:
        parser.error(str(error))


if __name__ == "__main__":
    sys.exit(command(main))
