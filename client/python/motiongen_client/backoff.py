"""When to try again: delays that grow, with jitter, and which ends of a stream are worth it. Pure."""

from __future__ import annotations

import random
from collections.abc import Callable

FIRST_DELAY_S, GROWTH, LONGEST_DELAY_S = 0.05, 1.6, 2.0
LONGEST_ASKED_S = 3600.0
"""The most that a server can be set to ask for: one that says a century shall not be lost for good."""
SOON_S, LONGEST_SOON_DELAY_S = 3.0, 0.25
"""For as long as what a client holds may last, it is not another second that it loses to a server that is back."""

FINAL_CODES = frozenset({"INVALID_ARGUMENT", "UNAUTHENTICATED", "PERMISSION_DENIED", "UNIMPLEMENTED"})
"""Ends of a stream that would be the same again; any other is the loss of the transport, whatever a proxy calls it."""


class Backoff:
    """The delays before one attempt and the next, each of them somewhere in the upper half of what it may be.

    random_share: a number from 0 to 1 at each call; so that those who lost the same server do not come back as one.
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
        """An attempt has come to something: begin with short delays again."""
        self._delay_s, self._waited_s = FIRST_DELAY_S, 0.0
