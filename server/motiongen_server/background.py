"""Runs work beside the event loop that may take minutes and must not keep the process from ending."""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def start_in_background(work: Callable[[], T], name: str) -> asyncio.Future[T]:
    """Run `work` on a daemon thread of that name; the future gets its result, and nobody has to await it."""
    loop = asyncio.get_running_loop()
    outcome: asyncio.Future[T] = loop.create_future()

    def settle(act: Callable[[], None]) -> None:
        with contextlib.suppress(RuntimeError):  # the loop is closed: nobody waits any more
            loop.call_soon_threadsafe(lambda: None if outcome.done() else act())

    def run_work() -> None:
        nonlocal work
        try:
            result = work()
        except Exception as error:
            failure = error  # outlives the except clause
            settle(lambda: outcome.set_exception(failure))
        else:
            del work  # else its objects would live on for a moment after the future is done
            settle(lambda: outcome.set_result(result))

    threading.Thread(target=run_work, name=name, daemon=True).start()
    return outcome
