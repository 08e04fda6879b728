"""Child: the gateway's handle of an engine process: starts it, notices its death, kills it."""

from __future__ import annotations

import contextlib
import logging
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Protocol

from motiongen_server.engine_process import signals

_log = logging.getLogger(__name__)

END_S = 5.0
"""How long an engine process may take to end after its last message."""
KILL_S = 5.0
"""How long to wait for a process that was killed: one that waits for a device or disk in the kernel lives on."""


class Child(Protocol):
    """A process that gets the folder of its gateway's sockets, and whose standard input ends with the gateway."""

    @property
    def pid(self) -> int: ...

    def fileno(self) -> int:
        """A descriptor that becomes readable when the process has died."""

    def kill(self) -> None:
        """Kill it at once. From any thread."""

    def ended(self, patience_s: float) -> str:
        """How it ended, in words, once it has died; without details if the system does not give them in that time."""

    def end(self, patience_s: float) -> str:
        """Wait for its end, kill it if it does not end, and say how it ended.

        Waits at most `KILL_S` after killing it.
        """

    def close(self) -> None:
        """Close its descriptors, after `end`."""


StartChild = Callable[[Path, Mapping[str, str]], Child]
"""Starts a process, given a folder and additional environment variables. Raises OSError if that fails."""


class FreshChild:
    """A `Child` started as a new program, since a process in which gRPC runs must not be forked."""

    def __init__(self, command: Sequence[str], folder: Path, environment: Mapping[str, str]) -> None:
        """environment: variables in addition to this process's. Raises OSError if it cannot be started."""
        self._death, held_open = os.pipe()
        try:
            with signals.held_back():
                self._process = subprocess.Popen(
                    [*command, str(folder)],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.DEVNULL,
                    env={**os.environ, **environment},
                    pass_fds=(held_open,),
                )
        except OSError:
            os.close(self._death)
            raise
        finally:
            os.close(held_open)

    @property
    def pid(self) -> int:
        return self._process.pid

    def fileno(self) -> int:
        return self._death

    def kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()

    def ended(self, patience_s: float) -> str:
        return how_it_ended(self._code_within(patience_s))

    def end(self, patience_s: float) -> str:
        code = self._code_within(patience_s)
        if code is None:
            self.kill()
            code = self._code_within(KILL_S)
        if self._process.stdin is not None:
            self._process.stdin.close()
        if code is None:
            # Reaps it whenever it ends.
            threading.Thread(target=self._process.wait, name=f"reap-{self.pid}", daemon=True).start()
            return left_behind(self.pid)
        return how_it_ended(code)

    def _code_within(self, patience_s: float) -> int | None:
        try:
            return self._process.wait(patience_s)
        except subprocess.TimeoutExpired:
            return None

    def close(self) -> None:
        os.close(self._death)


def how_it_ended(code: int | None) -> str:
    """How a process ended, in words. code: its exit code, or the negated number of a signal; None: unknown."""
    if code is None:
        return "has died"
    return f"killed by {_signal_name(-code)}" if code < 0 else f"ended with exit code {code}"


def _signal_name(number: int) -> str:
    try:
        return signal.Signals(number).name
    except ValueError:  # a real-time signal, most of which have no name
        return f"signal {number}"


def left_behind(pid: int) -> str:
    """Log that a process was killed and has not died; returns that in words."""
    _log.error("process %d was killed and is still there after %g s: nobody waits for it any longer", pid, KILL_S)
    return f"was killed, but is still there: process {pid}"
