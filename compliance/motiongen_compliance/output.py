"""How commands end: a reader of their output that leaves, as `| head` does, does not end them; Ctrl-C does."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from typing import Any


class OutputFailed(OSError):
    """Standard output could not be written to, for another reason than that its reader has left."""


class _Output(io.FileIO):
    """A file that drops what is written after the first failure."""

    _has_failed = False

    def write(self, data: Any, /) -> int:
        if self._has_failed:
            return len(data)
        try:
            return super().write(data)
        except OSError as error:
            self._has_failed = True
            if not isinstance(error, BrokenPipeError):
                raise OutputFailed(error.errno, error.strerror, "standard output") from None
            return len(data)


def command(main: Callable[[], int | None]) -> int | None:
    """Run the main function of a process, and return its exit code; 1 if what it printed could not be written.

    If the reader of standard output leaves, `main` goes on, and what it prints goes nowhere: its files and its exit
    code stay what they would have been. Ctrl-C ends it with 130, as shells expect.
    """
    usual = sys.stdout
    if usual is None:  # it was closed before the process began; some libraries need one
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115  # until the process ends
    elif usual is sys.__stdout__ and isinstance(usual, io.TextIOWrapper):  # another in tests
        sys.stdout = _outliving(usual)
    try:
        try:
            return main()
        finally:
            sys.stdout.flush()
    except OutputFailed as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    finally:
        sys.stdout = usual


def _outliving(usual: io.TextIOWrapper) -> io.TextIOWrapper:
    """Standard output that shows any file name, and that can lose its reader."""
    is_shown_at_once = usual.line_buffering or usual.write_through
    buffered = io.BufferedWriter(_Output(usual.fileno(), "wb", closefd=False))
    return io.TextIOWrapper(buffered, usual.encoding, "backslashreplace", line_buffering=is_shown_at_once)
