"""Signals that ask to stop are the gateway's business: it drains, and tells its engine processes when to end.

A terminal's Ctrl-C and a service manager's SIGTERM reach every process of the group, from its first moment on.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator

ASKING_TO_STOP = (signal.SIGINT, signal.SIGTERM)


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """A process that this thread starts meanwhile has them wait until it calls `ignore`.

    Python needs some tenths of a second to get there, in which they would end it.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKING_TO_STOP)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def ignore() -> None:
    """From now on and for what waits. In the main thread of an engine process, or of what those are forked from."""
    for number in ASKING_TO_STOP:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING_TO_STOP)
