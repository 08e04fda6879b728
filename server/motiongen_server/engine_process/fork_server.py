"""`python -m motiongen_server.engine_process.fork_server`: the process that engine processes are forked from.

It imports what they need, so that they share that memory and start faster. It has one thread and never computes: a lock
held by another thread would stay locked in forked processes. Its standard input is a packet socket from the gateway,
each packet of which requests one process. It ends with the gateway or, once the gateway has closed the socket, with the
last process.
"""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import os
import select
import signal
import socket
import sys
from collections.abc import Callable
from pathlib import Path

from motiongen_server.engine_process import signals

_log = logging.getLogger(__name__)

REQUEST_BYTES = 1 << 16
REQUEST_FDS = 3
"""The process's standard input; what it holds open while it lives; where its pid and how it ended are written."""
NUMBER_BYTES = 8
"""Size of its pid, and then of its exit code or the negated number of a signal: signed, little endian."""

RunEngine = Callable[[Path], int]
"""What a forked process runs, given the folder of its gateway's sockets. Returns its exit code."""


class ForkServer:
    """Forks a process for each request, and reports how each of them ended."""

    def __init__(self, requests: socket.socket, run: RunEngine) -> None:
        self._requests = requests
        self._run = run
        self._tells: dict[int, int] = {}  # by pid: where to report its end
        self._woken, self._wakes = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)

    def serve(self) -> None:
        """Serve until no more requests can come and all processes have ended."""
        signal.set_wakeup_fd(self._wakes, warn_on_full_buffer=False)
        signal.signal(signal.SIGCHLD, lambda *_: None)  # a signal without a handler does not wake it
        news = select.poll()
        news.register(self._requests, select.POLLIN)
        news.register(self._woken, select.POLLIN)
        is_asked = True
        while is_asked or self._tells:
            for descriptor, _ in news.poll():
                if descriptor == self._woken:
                    self._tell_ends()
                elif not self._answer():
                    is_asked = False
                    news.unregister(self._requests)

    def _answer(self) -> bool:
        """Take one request. False if there will be no more."""
        request, fds, _, _ = socket.recv_fds(self._requests, REQUEST_BYTES, REQUEST_FDS)
        if not request:
            return False
        lifeline_end, held_open, tells = fds
        try:
            pid = os.fork()
        except OSError:  # the gateway notices when `tells` is closed
            _log.exception("no engine process can be forked")
            os.close(tells)
        else:
            if pid == 0:
                self._become(json.loads(request), lifeline_end, tells)
            self._tells[pid] = tells
            self._tell(tells, pid)
        os.close(lifeline_end)
        os.close(held_open)
        return True

    def _become(self, request: dict[str, object], lifeline_end: int, tells: int) -> None:
        """Run the forked process, and end it. `held_open` is never touched."""
        code = 1
        try:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            os.dup2(lifeline_end, sys.stdin.fileno())
            self._requests.close()
            for descriptor in (lifeline_end, tells, self._woken, self._wakes, *self._tells.values()):
                os.close(descriptor)
            environment = request["environment"]
            assert isinstance(environment, dict)
            os.environ.update(environment)
            code = self._run(Path(str(request["folder"])))
        except BaseException:
            _log.exception("an engine process failed")
        finally:
            # Not the interpreter's normal exit: with torch loaded that takes seconds, and it would return to `serve`.
            os._exit(code)

    def _tell_ends(self) -> None:
        """Report how the processes that have ended did so."""
        with contextlib.suppress(BlockingIOError):
            os.read(self._woken, REQUEST_BYTES)
        while self._tells:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if not pid:
                return
            tells = self._tells.pop(pid)
            self._tell(tells, os.waitstatus_to_exitcode(status))
            os.close(tells)

    @staticmethod
    def _tell(tells: int, number: int) -> None:
        with contextlib.suppress(BrokenPipeError):  # the gateway no longer listens
            os.write(tells, number.to_bytes(NUMBER_BYTES, "little", signed=True))


def main() -> None:
    """Import all that engine processes need, then serve."""
    signals.ignore()

    from motiongen_server.engine_process.main import run
    from motiongen_server.engine_process.model_loading import import_libraries, prepare
    from motiongen_server.ops.memory import give_back_freed_memory, keep_freed_memory, use_one_arena

    keep_freed_memory()
    use_one_arena()
    import_libraries()
    gc.collect()
    gc.freeze()  # garbage collection writes to all objects, and memory that is written to is no longer shared
    give_back_freed_memory()
    # A duplicate, because forked processes replace standard input.
    requests = socket.socket(fileno=os.dup(sys.stdin.fileno()))
    ForkServer(requests, lambda folder: run(folder, prepare)).serve()


if __name__ == "__main__":
    main()
