"""HealthPace: limits how often health checks are answered. Callers that ask more often have to wait.

No caller can use up the checks of another: behind a proxy, clients and the proxy's own checks share an address, so each
connection has an equal share of its address's checks, and never waits as long as it keeps to that.
"""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from math import inf

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket
from motiongen_server.rpc.errors.too_many_calls import too_many_health_checks

CHECKS_PER_SECOND = 100.0
"""Per address; a proxy that checks a server asks once every few seconds."""
MOST_WAIT_S = 1.0
MOST_WAITING = 512
MOST_WAITING_OF_AN_ADDRESS = 128
MOST_WAITING_OF_A_CONNECTION = 64
FORGET_AFTER_S = 2.0
"""A connection that asks nothing for this long loses its share, and its debt is forgotten."""


class _Address:
    """The checks of one address, and how many connections share them."""

    def __init__(self, now: float) -> None:
        self.bucket = TokenBucket(CHECKS_PER_SECOND, now)
        self.num_connections = 0
        self.num_waiting = 0


class _Connection:
    """A connection's share of its address's checks, and how many of its checks wait."""

    def __init__(self, address: _Address, now: float) -> None:
        address.num_connections += 1
        self.address = address
        self.share = Share(address.bucket, lambda: address.num_connections, now)
        self.asked_at = now
        self.at_once_at = -inf  # when it was last answered because too many waited
        self.num_waiting = 0


class HealthPace:
    """Lives on one event loop. now: monotonic seconds."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._addresses: dict[str, _Address] = {}
        self._connections: dict[str, _Connection] = {}
        self._num_waiting = 0
        self._swept_at = now()

    async def wait(self, peer: str) -> None:
        """Wait until a check of this caller may be answered. peer: as gRPC names it.

        Raises StreamRefused, at no cost to the caller, if too many checks wait already. Even then, one check a second
        is answered at once for a connection that has none waiting.
        """
        now = self._now()
        connection = self._connection(peer, now)
        address, waiting = connection.address, connection.num_waiting
        is_full = address.num_waiting >= MOST_WAITING_OF_AN_ADDRESS or self._num_waiting >= MOST_WAITING
        is_again = connection.share.owed_s(now) > 0.0 and now - connection.at_once_at < MOST_WAIT_S
        if (is_full and (waiting or is_again)) or waiting >= MOST_WAITING_OF_A_CONNECTION:
            raise too_many_health_checks(max(connection.share.owed_s(now), 1.0 / CHECKS_PER_SECOND))
        connection.share.charge(1.0, now)
        owed_s = connection.share.owed_s(now)
        if owed_s <= 0.0:
            return
        if is_full:
            connection.at_once_at = now
            return
        connection.num_waiting += 1
        address.num_waiting += 1
        self._num_waiting += 1
        try:
            await asyncio.sleep(min(owed_s, MOST_WAIT_S))
        finally:
            connection.num_waiting -= 1
            address.num_waiting -= 1
            self._num_waiting -= 1

    def _connection(self, peer: str, now: float) -> _Connection:
        if now - self._swept_at >= FORGET_AFTER_S:
            self._forget_silent(now)
        connection = self._connections.get(peer)
        if connection is None:
            name = address_of(peer)
            address = self._addresses.setdefault(name, _Address(now))
            connection = self._connections[peer] = _Connection(address, now)
        connection.asked_at = now
        return connection

    def _forget_silent(self, now: float) -> None:
        self._swept_at = now
        self._connections = {
            peer: each
            for peer, each in self._connections.items()
            if each.num_waiting or now - each.asked_at < FORGET_AFTER_S
        }
        counted = Counter(address_of(peer) for peer in self._connections)
        for name, address in list(self._addresses.items()):
            address.num_connections = counted[name]
            if not counted[name] and address.bucket.is_full(now):
                del self._addresses[name]
