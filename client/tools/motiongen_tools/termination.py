"""A command that is told to end: by Ctrl-C, by SIGTERM, or by the terminal that it runs in, which is closed."""

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
    """Let signals raise Terminated, and Ctrl-C KeyboardInterrupt, so that what is under way is put in order.

    By default signals would end the process at once, and a server that it has started would stay. From Ctrl-C asyncio
    would have it wait until a command waits for the loop, which none does while it starts a server.
    """

    def end(number: int, _: FrameType | None) -> NoReturn:
        raise Terminated(128 + number)

    def interrupt(_number: int, _: FrameType | None) -> NoReturn:
        raise KeyboardInterrupt

    is_main = threading.current_thread() is threading.main_thread()  # others cannot set handlers
    handlers = dict.fromkeys(_SIGNALS, end) | {signal.SIGINT: interrupt}
    usual = (signal.SIG_DFL, signal.default_int_handler)  # nohup ignores one
    before = {each: found for each in handlers if is_main and (found := signal.getsignal(each)) in usual}
    for each in before:
        signal.signal(each, handlers[each])
    try:
        yield
    finally:
        for each, found in before.items():
            signal.signal(each, found)
