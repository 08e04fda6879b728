"""CallPace: how many calls of an address are begun a second; of what is more nothing is read, and nobody is told why.

To tell a caller why he is refused takes the event loop more than he needs to ask, above all who resets his calls as
soon as he has begun them, so that HTTP/2's limit of calls at once is none. gRPC begins the calls of a method one after
another, whoever they come from, so those of others wait behind them; once thousands wait, gRPC ends some by chance.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import TokenBucket

CALLS_A_SECOND = 2_000
"""Of an address, however many tenants call from there. Of all a gateway begins some 5,000."""
HEADERS_A_CALL = 64
"""That count as one call more. Every one is read several times; callers have twenty, and may have five hundred."""
MOST_IDLE = 1024
"""Addresses that are remembered though none of their last second's calls counts any more."""
LOOK_EVERY_S = 1.0  # at all of them, as `Peers`


class CallPace:
    """Of the calls of one service. Lives on the event loop."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._addresses: dict[str, TokenBucket] = {}
        self._looked_at = -inf

    @property
    def num_addresses(self) -> int:
        """That are remembered."""
        return len(self._addresses)

    def allows(self, peer: str) -> bool:
        """Whether a call may be begun now, which counts as begun. peer: who calls, as gRPC names it."""
        address, now = address_of(peer), self._clock()
        calls = self._addresses.get(address)
        if calls is None:
            if len(self._addresses) >= MOST_IDLE and now - self._looked_at >= LOOK_EVERY_S:
                self._looked_at = now
                self._addresses = {name: each for name, each in self._addresses.items() if not each.is_full(now)}
            calls = self._addresses[address] = TokenBucket(CALLS_A_SECOND, now)
        return calls.take(now)

    def charge(self, peer: str, num_headers: int) -> None:
        """A call that was begun turns out to have so many headers."""
        if more := num_headers // HEADERS_A_CALL:
            self._addresses[address_of(peer)].charge(more, self._clock())
