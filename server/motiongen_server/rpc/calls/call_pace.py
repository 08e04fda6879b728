"""CallPace: limits how many calls an address begins per second. Calls beyond that are dropped unread.

Telling a caller why it is refused takes the event loop longer than asking takes the caller, above all if it resets its
calls as soon as they begin: HTTP/2's limit of concurrent calls does not prevent that. gRPC begins the calls of a method
one after another, whoever they come from, so other callers wait behind them. Once thousands wait, gRPC ends some of
them at random.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from math import inf

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import TokenBucket

CALLS_A_SECOND = 2_000
"""Of one address, however many tenants call from it. A gateway can begin some 5,000 in all."""
HEADERS_A_CALL = 64
"""This many headers count as one call more. Each is read several times; callers send about 20, and may send 500."""
MOST_IDLE = 1024
"""Addresses that are kept without looking for those whose budget is full again."""
LOOK_EVERY_S = 1.0  # least time between two looks at all of them, as in `Peers`


class CallPace:
    """The calls of one service. Lives on the event loop."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._addresses: dict[str, TokenBucket] = {}
        self._looked_at = -inf

    @property
    def num_addresses(self) -> int:
        """Addresses that are kept."""
        return len(self._addresses)

    def allows(self, peer: str) -> bool:
        """Whether a call may begin now; if so it is counted. peer: the caller, as gRPC names it."""
        address, now = address_of(peer), self._clock()
        calls = self._addresses.get(address)
        if calls is None:
            if len(self._addresses) >= MOST_IDLE and now - self._looked_at >= LOOK_EVERY_S:
                self._looked_at = now
                self._addresses = {name: each for name, each in self._addresses.items() if not each.is_full(now)}
            calls = self._addresses[address] = TokenBucket(CALLS_A_SECOND, now)
        return calls.take(now)

    def charge(self, peer: str, num_headers: int) -> None:
        """Count the headers of a call that has begun."""
        if more := num_headers // HEADERS_A_CALL:
            self._addresses[address_of(peer)].charge(more, self._clock())
