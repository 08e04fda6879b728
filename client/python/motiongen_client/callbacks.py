"""Callbacks: calling the functions that an application sets for events of a session."""

from __future__ import annotations

import logging
from collections.abc import Callable
from inspect import iscoroutine
from typing import TypeVar

_log = logging.getLogger(__name__)

T = TypeVar("T")


def call_back(callback: Callable[[T], None] | None, told: T) -> None:
    """Call the application's callback, if set. An exception in it is logged, not raised.

    Callbacks run in the stream's read loop: an exception there would end it for all sessions of the stream.
    """
    if callback is None:
        return
    try:
        answer: object = callback(told)
        if iscoroutine(answer):  # of an `async def`, which nobody would await
            answer.close()
            raise TypeError("a callback must be a plain function; it may create a task")
    except Exception:
        _log.exception("a callback of the application failed on: %s", told)
