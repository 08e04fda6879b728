"""The command `motiongen`, also `python -m motiongen_tools`."""

from __future__ import annotations

import signal
import sys


def main() -> int:
    """The exit code, as `cli.run` has it."""
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_usual:  # nothing has begun yet that a Ctrl-C would have to put in order
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    # Only now, because it takes a second.
    from motiongen_tools.cli import run

    if is_usual:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
