"""A command that is told to end: by SIGTERM, or by the terminal that it runs in, which is closed."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Terminated(SystemExit):
    """The process was told to end; its code is that of shells. Of the kind that event loops let through."""


@contextlib.contextmanager
def terminating() -> Iterator[None]:
    """Let these signals raise Terminated, so that what is under way is put in order as by Ctrl-C.

    By default they would end the process at once, and a server that it has started would stay.
    """

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise Terminated(128 + number)

    is_main = threading.current_thread() is threading.main_thread()  # others cannot set handlers
    heard = [each for each in _SIGNALS if is_main and signal.getsignal(each) == signal.SIG_DFL]  # nohup ignores one
    for each in heard:
        signal.signal(each, end)
    try:
        yield
    finally:
        for each in heard:
            signal.signal(each, signal.SIG_DFL)
