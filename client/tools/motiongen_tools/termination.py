"""Ends a command cleanly on Ctrl-C, on SIGTERM, and when its terminal is closed."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import NoReturn

_SIGNALS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


class Terminated(SystemExit):
    """A signal ended the process; the code is that of shells. As a SystemExit, it passes through event loops."""


@contextlib.contextmanager
def terminating() -> Iterator[None]:
    """Let signals raise Terminated, and Ctrl-C KeyboardInterrupt, so that what is under way is cleaned up.

    By default, signals would end the process at once and leave behind a server that it started. asyncio's own handling
    of Ctrl-C only takes effect when the command waits for the event loop, and no command does while it starts a server.
    """

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise Terminated(128 + number)

    def interrupt(_number: int, _: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt

    is_main = threading.current_thread() is threading.main_thread()  # only that thread can set handlers
    handlers = dict.fromkeys(_SIGNALS, end) | {signal.SIGINT: interrupt}
    usual = (signal.SIG_DFL, signal.default_int_handler)  # others stay: nohup ignores SIGHUP
    before = {each: found for each in handlers if is_main and (found := signal.getsignal(each)) in usual}
    for each in before:
        signal.signal(each, handlers[each])
    try:
        yield
    finally:
        for each, found in before.items():
            signal.signal(each, found)
