"""Bell: wakes a thread that polls sockets, from any other thread."""

from __future__ import annotations

import contextlib
import os
import threading


class Bell:
    """A file descriptor that is readable from `ring` to `quiet`."""

    def __init__(self) -> None:
        self._reads, self._writes = os.pipe()
        os.set_blocking(self._reads, False)
        self._lock = threading.Lock()
        self._is_rung = False
        self._is_closed = False

    def fileno(self) -> int:
        """The descriptor to poll."""
        return self._reads

    def ring(self) -> None:
        """Wake the thread. From any thread; costs next to nothing while the bell is still ringing."""
        with self._lock:
            if not self._is_rung and not self._is_closed:
                self._is_rung = True
                os.write(self._writes, b"\0")

    def quiet(self) -> None:
        """Stop ringing; to be called before doing what it was rung for."""
        with self._lock:
            if self._is_rung:
                self._is_rung = False
                os.read(self._reads, 1)

    def close(self) -> None:
        """From now on ringing does nothing."""
        with self._lock:
            self._is_closed = True
            for number in (self._reads, self._writes):
                with contextlib.suppress(OSError):
                    os.close(number)
