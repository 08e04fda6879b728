"""The gateway's side of forking engine processes: ForkServerLink for the fork server, ForkedChild for each process."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path

from motiongen_server.engine_process import signals
from motiongen_server.engine_process.child import KILL_S, how_it_ended, left_behind
from motiongen_server.engine_process.fork_server import NUMBER_BYTES

FORK_SERVER = (sys.executable, "-m", "motiongen_server.engine_process.fork_server")
FORK_S = 60.0
"""How long a fork may take; the first one waits until the fork server has imported what engines need."""


class ForkedChild:
    """A `Child` whose parent is a fork server."""

    def __init__(self, lifeline: int, death: int, told: int) -> None:
        """Takes the gateway's ends of its three pipes, and waits until the fork server has reported its pid.

        Raises ChildProcessError if it does not.
        """
        self._lifeline, self._death, self._told = lifeline, death, told
        pid = _told_number(told, FORK_S)
        if pid is None:
            self.close()
            raise ChildProcessError("the process that engines are forked from has forked none; its messages say why")
        self._pid = pid
        self._code: int | None = None

    @property
    def pid(self) -> int:
        return self._pid

    def fileno(self) -> int:
        return self._death

    def kill(self) -> None:
        if not self._has_died(0.0):  # else its pid may belong to another process by now
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)

    def ended(self, patience_s: float) -> str:
        return how_it_ended(self._code_within(patience_s))

    def end(self, patience_s: float) -> str:
        if not self._has_died(patience_s):
            self.kill()
            if not self._has_died(KILL_S):
                return left_behind(self._pid)  # the fork server reaps it
        code = self._code_within(KILL_S)
        return "ended after what it was forked from" if code is None else how_it_ended(code)

    def close(self) -> None:
        for descriptor in (self._lifeline, self._death, self._told):
            os.close(descriptor)

    def _code_within(self, patience_s: float) -> int | None:
        if self._code is None:  # it is reported only once
            self._code = _told_number(self._told, patience_s)
        return self._code

    def _has_died(self, patience_s: float) -> bool:
        """Whether it has died, waiting for that up to `patience_s`."""
        return _can_be_read(self._death, patience_s)


class ForkServerLink:
    """Starts the fork server with the first engine process, and again if it was lost. From any thread."""

    def __init__(self, command: Sequence[str] = FORK_SERVER) -> None:
        self._command = command
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._requests: socket.socket | None = None
        self._has_forked = False
        self._is_stopped = False

    @property
    def pid(self) -> int | None:
        """The fork server's pid; None before it was started."""
        return None if self._process is None else self._process.pid

    def start(self, folder: Path, environment: Mapping[str, str]) -> ForkedChild:
        """A `StartChild`. Raises OSError if no process can be forked."""
        request = json.dumps({"folder": str(folder), "environment": dict(environment)}).encode()
        (lifeline_end, lifeline), (death, held_open), (told, tells) = _pipes(3)
        theirs = [lifeline_end, held_open, tells]
        try:
            with self._lock:
                socket.send_fds(self._running(), [request], theirs)
                asked = self._process
        except OSError:
            for descriptor in (lifeline, death, told):
                os.close(descriptor)
            raise
        finally:
            for descriptor in theirs:
                os.close(descriptor)
        try:
            child = ForkedChild(lifeline, death, told)
        except ChildProcessError:
            self._give_up(asked)
            raise
        self._has_forked = True
        return child

    def _give_up(self, asked: subprocess.Popen[bytes] | None) -> None:
        """Kill a fork server that no longer answers, unless it has never forked: then it may still be importing."""
        with self._lock:
            if self._has_forked and asked is not None and asked is self._process:
                asked.kill()

    def _running(self) -> socket.socket:
        """The socket of a fork server that is running, or was a moment ago; starts one if there is none."""
        if self._is_stopped:
            raise ChildProcessError("the server is going away")
        if self._requests is not None and self._process is not None and self._process.poll() is None:
            return self._requests
        if self._requests is not None:
            self._requests.close()
        self._requests, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            # One thread: others would only wait in it for work, and would be missing in forked processes.
            environment = {**os.environ, "OMP_NUM_THREADS": "1"}
            with signals.held_back():
                self._process = subprocess.Popen(
                    self._command, stdin=theirs.fileno(), stdout=subprocess.DEVNULL, env=environment
                )
        return self._requests

    def stop(self) -> None:
        """Fork no more. Forked processes continue; a wait for the first fork ends with an error."""
        with self._lock:
            self._is_stopped = True
            if self._requests is not None:
                self._requests.close()
            if self._process is not None and not self._has_forked:
                self._process.kill()

    def join(self, timeout_s: float) -> None:
        """After `stop`: wait for its end, after that of all forked processes; kill it when the time is up."""
        if self._process is None:
            return
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def _pipes(count: int) -> list[tuple[int, int]]:
    """Opens that many pipes. Raises OSError, and leaves none open, if it cannot."""
    made: list[tuple[int, int]] = []
    try:
        for _ in range(count):
            made.append(os.pipe())
    except OSError:
        for descriptor in (each for pipe in made for each in pipe):
            os.close(descriptor)
        raise
    return made


def _told_number(told: int, patience_s: float) -> int | None:
    """The next number from a fork server; None if none arrives in time, or none ever will."""
    if not _can_be_read(told, patience_s):
        return None
    data = os.read(told, NUMBER_BYTES)
    return int.from_bytes(data, "little", signed=True) if data else None


def _can_be_read(descriptor: int, patience_s: float) -> bool:
    poll = select.poll()  # `select.select` takes small descriptors only
    poll.register(descriptor, select.POLLIN)
    return bool(poll.poll(1000 * patience_s))
