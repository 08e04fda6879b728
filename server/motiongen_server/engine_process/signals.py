"""Keeps signals to stop away from engine processes: the gateway drains, and tells them when to end.

A terminal's Ctrl-C and a service manager's SIGTERM reach every process of the group, from its first moment on.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

ASKING_TO_STOP = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Block these signals in processes that this thread starts within it, until they call `ignore`.

    Python needs some tenths of a second to get there, and a signal in that time would end the process.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKING_TO_STOP)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """Ignore these signals, also pending ones. In the main thread of an engine process, or of the fork server."""
    for number in ASKING_TO_STOP:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING_TO_STOP)
