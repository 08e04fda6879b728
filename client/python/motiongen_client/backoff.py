"""Backoff: growing delays with jitter between attempts, and which ends of a stream are final. Pure."""

from __future__ import annotations

import random
from collections.abc import Callable

FIRST_DELAY_S, GROWTH, LONGEST_DELAY_S = 0.05, 1.6, 2.0
LONGEST_ASKED_S = 3600.0
"""Limit on the wait that a server may ask for, so that no bad value keeps a client away for good."""
SOON_S, LONGEST_SOON_DELAY_S = 3.0, 0.25
"""Delays stay short for the time that a client's buffered frames may last, so that a quick return is not missed."""

FINAL_CODES = frozenset({"INVALID_ARGUMENT", "UNAUTHENTICATED", "PERMISSION_DENIED", "UNIMPLEMENTED"})
"""Statuses that a new call would get again. Any other counts as a loss of the connection, whatever a proxy calls it."""


class Backoff:
    """The delays between attempts, each drawn at random from the upper half of its range.

    random_share: returns a number from 0 to 1; so clients that lost the same server do not all return at once.
    """

    def __init__(self, random_share: Callable[[], float] = random.random) -> None:
        self._random_share = random_share
        self._delay_s, self._waited_s = FIRST_DELAY_S, 0.0

    def next_s(self, at_least_s: float = 0.0) -> float:
        """Seconds to wait before the next attempt. at_least_s: what the server asked for, heeded up to an hour."""
        delay_s = max(self._delay_s * (0.5 + 0.5 * self._random_share()), min(at_least_s, LONGEST_ASKED_S))
        self._waited_s += delay_s
        longest_s = LONGEST_DELAY_S if self._waited_s >= SOON_S else min(LONGEST_SOON_DELAY_S, LONGEST_DELAY_S)
        self._delay_s = min(self._delay_s * GROWTH, longest_s)
        return delay_s

    def reset(self) -> None:
        """An attempt succeeded: begin with short delays again."""
        self._delay_s, self._waited_s = FIRST_DELAY_S, 0.0
