"""SparingLog: limits how often a message is logged that clients can cause as often as they like."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable

QUIET_S = 10.0


class SparingLog:
    """Logs one line in ten seconds, with the number left out since the last one. Used on the event loop only."""

    def __init__(self, log: logging.Logger, clock: Callable[[], float] = time.monotonic) -> None:
        self._log = log
        self._clock = clock
        self._quiet_until = -QUIET_S
        self._left_out = 0

    def info(self, message: str, *values: object) -> None:
        """Log a message, unless one was logged in the last ten seconds."""
        self._say(logging.INFO, message, values)

    def error(self, message: str, *values: object, fault: Exception | None = None) -> None:
        """The same for a fault of the server's own, with its traceback."""
        self._say(logging.ERROR, message, values, fault)

    def _say(self, level: int, message: str, values: tuple[object, ...], fault: Exception | None = None) -> None:
        now = self._clock()
        if now < self._quiet_until:
            self._left_out += 1
            return
        self._quiet_until = now + QUIET_S
        left_out, self._left_out = self._left_out, 0
        since = f" (and {left_out} like it since the last one)" if left_out else ""
        self._log.log(level, message + since, *values, exc_info=fault)
