"""HealthPace: limits how often health checks are answered. Callers that ask more often have to wait.

No caller can use up the checks of another: behind a proxy, clients and the proxy's own checks share an address, so each
connection has an equal share of its address's checks, and never waits as long as it keeps to that.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from math import inf
from weakref import WeakKeyDictionary

from motiongen_server.rpc.budgets.connection_shares import Connection, ConnectionShares
from motiongen_server.rpc.errors.too_many_calls import too_many_health_checks

CHECKS_PER_SECOND = 100.0
"""Per address; a proxy that checks a server asks once every few seconds."""
MOST_WAIT_S = 1.0
MOST_WAITING = 512
MOST_WAITING_OF_AN_ADDRESS = 128
MOST_WAITING_OF_A_CONNECTION = 64


class HealthPace:
    """Lives on one event loop. now: monotonic seconds."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._shares = ConnectionShares(CHECKS_PER_SECOND, now())
        # When connections were last answered because too many checks waited.
        self._at_once_at: WeakKeyDictionary[Connection, float] = WeakKeyDictionary()
        self._num_waiting = 0

    async def wait(self, peer: str) -> None:
        """Wait until a check of this caller may be answered. peer: as gRPC names it.

        Raises StreamRefused, at no cost to the caller, if too many checks wait already. Even then, one check a second
        is answered at once for a connection that has none waiting.
        """
        now = self._now()
        connection = self._shares.of(peer, now)
        address, waiting = connection.address, connection.num_waiting
        is_full = address.num_waiting >= MOST_WAITING_OF_AN_ADDRESS or self._num_waiting >= MOST_WAITING
        is_again = connection.share.owed_s(now) > 0.0 and now - self._at_once_at.get(connection, -inf) < MOST_WAIT_S
        if (is_full and (waiting or is_again)) or waiting >= MOST_WAITING_OF_A_CONNECTION:
            raise too_many_health_checks(max(connection.share.owed_s(now), 1.0 / CHECKS_PER_SECOND))
        connection.share.charge(1.0, now)
        owed_s = connection.share.owed_s(now)
        if owed_s <= 0.0:
            return
        if is_full:
            self._at_once_at[connection] = now
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
