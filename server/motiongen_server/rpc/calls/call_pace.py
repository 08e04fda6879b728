"""CallPace: limits how many calls an address begins per second. Calls beyond that are dropped unread.

Telling a caller why it is refused takes the event loop longer than asking takes the caller, above all if it resets its
calls as soon as they begin: HTTP/2's limit of concurrent calls does not prevent that. gRPC begins the calls of a method
one after another, whoever they come from, so other callers wait behind them. Once thousands wait, gRPC ends some of
them at random.

Clients behind one proxy or address translation share an address, so each connection has an equal share of its calls.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket

CALLS_A_SECOND = 2_000.0
"""Of one address, however many tenants call from it, unless the settings ask for others. A gateway can begin some 5,000
in all."""
HEADERS_A_CALL = 64
"""This many headers count as one call more. Each is read several times; callers send about 20, and may send 500."""
MOST_OWED_S = 1.0
"""Connections that call for the first time may do so ahead of their address's pace by this much. Without a bound, an
address could begin as many calls as it can open connections."""
FORGET_AFTER_S = 2.0
"""A connection that begins no call for this long loses its share, and its debt is forgotten."""


def calls_a_second(asked: float | None, peer_calls_per_second: float) -> float:
    """The pace that the settings ask for. asked: None: the default, or what a peer may do by another limit if more."""
    return max(CALLS_A_SECOND, peer_calls_per_second) if asked is None else asked


class _Address:
    """The calls of one address, and how many connections share them."""

    def __init__(self, rate: float, now: float) -> None:
        self.calls = TokenBucket(rate, now)
        self.num_connections = 0


class _Connection:
    """A connection's share of its address's calls."""

    def __init__(self, address: _Address, now: float) -> None:
        address.num_connections += 1
        self.address = address
        self.share = Share(address.calls, lambda: address.num_connections, now)
        self.called_at = now


class CallPace:
    """The calls of one service. Lives on the event loop."""

    def __init__(self, rate: float = CALLS_A_SECOND, clock: Callable[[], float] = time.monotonic) -> None:
        """rate: calls per second of one address."""
        self.rate = rate
        self._clock = clock
        self._addresses: dict[str, _Address] = {}
        self._connections: dict[str, _Connection] = {}
        self._swept_at = clock()

    @property
    def num_addresses(self) -> int:
        """Addresses that are kept."""
        return len(self._addresses)

    def allows(self, peer: str) -> bool:
        """Whether a call may begin now; if so it is counted. peer: the caller, as gRPC names it."""
        now = self._clock()
        connection = self._connection(peer, now)
        if connection.share.owed_s(now) > 0.0 or connection.address.calls.owed_s(now) > MOST_OWED_S:
            return False
        connection.share.charge(1.0, now)
        return True

    def charge(self, peer: str, num_headers: int) -> None:
        """Count the headers of a call that has begun."""
        if more := num_headers // HEADERS_A_CALL:
            now = self._clock()
            self._connection(peer, now).share.charge(more, now)

    def _connection(self, peer: str, now: float) -> _Connection:
        if now - self._swept_at >= FORGET_AFTER_S:
            self._forget_silent(now)
        connection = self._connections.get(peer)
        if connection is None:
            name = address_of(peer)
            address = self._addresses.get(name)
            if address is None:
                address = self._addresses[name] = _Address(self.rate, now)
            connection = self._connections[peer] = _Connection(address, now)
        connection.called_at = now
        return connection

    def _forget_silent(self, now: float) -> None:
        self._swept_at = now
        self._connections = {
            peer: each for peer, each in self._connections.items() if now - each.called_at < FORGET_AFTER_S
        }
        counted = Counter(map(address_of, self._connections))
        for name, address in list(self._addresses.items()):
            address.num_connections = counted[name]
            if not counted[name] and address.calls.is_full(now):
                del self._addresses[name]
