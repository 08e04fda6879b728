"""The command `motiongen`, also `python -m motiongen_tools`."""

from __future__ import annotations

import sys

from motiongen_tools.cli import run


def main() -> int:
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
