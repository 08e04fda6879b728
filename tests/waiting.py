"""Waiting for other processes and threads that have no event for it: asked again until it is so.

No result depends on how long that takes. Who waits in vain is ended by the test's own limit, far beyond what a busy
machine needs. A test that can have an event, a clock that it moves, or a process's end to wait for, takes that.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

LIMIT_S = 240.0
"""For waits that take a limit: who waits so long waits in vain. That of a test itself, in pyproject.toml, is longer."""
AGAIN_S = 0.01  # leaves the core to what is waited for


def until(condition: Callable[[], T]) -> T:
    """What a condition gives once that is true."""
    while not (found := condition()):
        time.sleep(AGAIN_S)
    return found


async def until_true(condition: Callable[[], T]) -> T:
    """The same for tests that run an event loop, which goes on meanwhile."""
    while not (found := condition()):  # noqa: ASYNC110  there is no event for it
        await asyncio.sleep(AGAIN_S)
    return found


async def try_again() -> None:
    """Before something is asked once more, that was refused for now."""
    await asyncio.sleep(AGAIN_S)
