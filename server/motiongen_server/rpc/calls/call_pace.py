"""CallPace: limits how many calls an address begins per second. Calls beyond that are dropped unread.

Telling a caller why it is refused takes the event loop longer than asking takes the caller, above all if it resets its
calls as soon as they begin: HTTP/2's limit of concurrent calls does not prevent that. gRPC begins the calls of a method
one after another, whoever they come from, so other callers wait behind them. Once thousands wait, gRPC ends some of
them at random.

Clients behind one proxy or address translation share an address, so each connection has an equal share of its calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from motiongen_server.rpc.budgets.connection_shares import ConnectionShares

CALLS_A_SECOND = 2_000.0
"""Of one address, however many tenants call from it, unless the settings ask for others. A gateway can begin some 5,000
in all."""
HEADERS_A_CALL = 64
"""This many headers count as one call more. Each is read several times; callers send about 20, and may send 500."""
MOST_OWED_S = 1.0
"""Connections that call for the first time may do so ahead of their address's pace by this much. Without a bound, an
address could begin as many calls as it can open connections."""


def calls_a_second(asked: float | None, peer_calls_per_second: float) -> float:
    """The pace that the settings ask for. asked: None: the default, or what a peer may do by another limit if more."""
    return max(CALLS_A_SECOND, peer_calls_per_second) if asked is None else asked


class CallPace:
    """The calls of one service. Lives on the event loop."""

    def __init__(self, rate: float = CALLS_A_SECOND, clock: Callable[[], float] = time.monotonic) -> None:
        """rate: calls per second of one address."""
        self.rate = rate
        self._clock = clock
        self._shares = ConnectionShares(rate, clock())

    @property
    def num_addresses(self) -> int:
        """Addresses that are kept."""
        return self._shares.num_addresses

    def allows(self, peer: str) -> bool:
        """Whether a call may begin now; if so it is counted. peer: the caller, as gRPC names it."""
        now = self._clock()
        connection = self._shares.of(peer, now)
        if connection.share.owed_s(now) > 0.0 or connection.address.bucket.owed_s(now) > MOST_OWED_S:
            return False
        connection.share.charge(1.0, now)
        return True

    def charge(self, peer: str, num_headers: int) -> None:
        """Count the headers of a call that has begun."""
        if more := num_headers // HEADERS_A_CALL:
            now = self._clock()
            self._shares.of(peer, now).share.charge(more, now)
