"""Waiting by polling, for conditions of other processes and threads that have no event.

No result depends on how long it takes. A test's own time limit, which is far beyond what a busy machine needs, ends a
wait that never succeeds. Tests prefer an event, a clock that they move, or the end of a process, where there is one.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

LIMIT_S = 240.0
"""For waits with a limit: after this time a wait has failed. A test's own limit, in pyproject.toml, is longer."""
AGAIN_S = 0.01  # leaves the core to the other process


def until(condition: Callable[[], T]) -> T:
    """The value of a condition, once it is true."""
    while not (found := condition()):
        time.sleep(AGAIN_S)
    return found


async def until_true(condition: Callable[[], T]) -> T:
    """`until` for tests with an event loop, which keeps running meanwhile."""
    while not (found := condition()):  # noqa: ASYNC110  there is no event for it
        await asyncio.sleep(AGAIN_S)
    return found


async def try_again() -> None:
    """Wait a moment before repeating something that was refused for the time being."""
    await asyncio.sleep(AGAIN_S)
