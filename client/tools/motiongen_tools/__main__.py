"""The command `motiongen`, also `python -m motiongen_tools`."""

from __future__ import annotations

import os
import signal
import sys


def main() -> int:
    """Run the command line of this process; returns the exit code, as `cli.run` does."""
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if is_usual:  # until the imports are done, Ctrl-C has nothing to clean up
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # the command itself reports what went wrong, once
    # Imported here because it takes a second, and because gRPC reads its variable when it is imported.
    from motiongen_tools.cli import run
    from motiongen_tools.output import command

    if is_usual:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    return command(lambda: run(sys.argv[1:])) or 0


if __name__ == "__main__":
    sys.exit(main())
