"""The functions that an application has called when something becomes of a session."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TypeVar

_log = logging.getLogger(__name__)

T = TypeVar("T")


def call_back(callback: Callable[[T], None] | None, told: T) -> None:
    """Tell the application, where it wants to know. What it raises is logged.

    It is called where the stream is read: all of its sessions would hear nothing more for one that fails.
    """
    if callback is None:
        return
    try:
        callback(told)
    except Exception:
        _log.exception("the application failed at what it was told: %s", told)
