"""CheckBudget: how many signed tokens that are not known yet are read and checked, and over which connections.

Anybody can write a token that does not hold, and it takes a check to see that. So a check is paid before the token is
read, by the connection that it came over, and given back where the token holds. Nobody else pays: behind a proxy all
clients have one address, and what some of them owe for calls must not keep out those who bring a token that holds.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from functools import partial

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Bucket, Share, TokenBucket
from motiongen_server.rpc.errors.too_many_calls import too_many_bad_tokens

CHECKS_PER_SECOND = 1_000.0
"""That fail, of all connections together: 7 % of a Zen 5's core, whatever the length of the tokens."""
CHARACTERS_A_CHECK = 1024.0
"""A token counts for one more with so many: to read 8 KB takes six times what its signature does."""
FORGET_AFTER_S = 2.0
"""A connection that has shown no new token for so long has no part any more, and its debt is over."""


class _Part:
    """Of the checks: an address's, or of that a connection's."""

    def __init__(self, of: Bucket, num_users: Callable[[], int], now: float) -> None:
        self.share = Share(of, num_users, now)
        self.num_connections = 0
        self.asked_at = now


class CheckBudget:
    """Addresses have equal parts, and of an address its connections: one that keeps to its part is never refused.

    A new connection has a part, too: what it costs to begin one is more than a check. Lives on one event loop.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._bucket = TokenBucket(CHECKS_PER_SECOND, clock())
        self._addresses: dict[str, _Part] = {}
        self._connections: dict[str, _Part] = {}
        self._swept_at = clock()

    def charge(self, peer: str, num_characters: int) -> Callable[[], None]:
        """Charge the check of a token of that length; returns what gives it back. peer: as gRPC names it.

        Raises StreamRefused while the connection owes for tokens that did not hold.
        """
        now, cost = self._clock(), 1.0 + num_characters / CHARACTERS_A_CHECK
        share = self._part(peer, now).share
        if (owed_s := share.owed_s(now)) > 0:
            raise too_many_bad_tokens(owed_s)
        share.charge(cost, now)
        return partial(self._give_back, share, cost)

    def _give_back(self, share: Share, cost: float) -> None:
        share.charge(-cost, self._clock())

    def _part(self, peer: str, now: float) -> _Part:
        if now - self._swept_at >= FORGET_AFTER_S:
            self._forget_silent(now)
        connection = self._connections.get(peer)
        if connection is None:
            address = self._address(address_of(peer), now)
            address.num_connections += 1
            connection = self._connections[peer] = _Part(address.share, lambda: address.num_connections, now)
        connection.asked_at = now
        return connection

    def _address(self, name: str, now: float) -> _Part:
        address = self._addresses.get(name)
        if address is None:
            address = self._addresses[name] = _Part(self._bucket, lambda: len(self._addresses), now)
        return address

    def _forget_silent(self, now: float) -> None:
        self._swept_at = now
        for peer, connection in list(self._connections.items()):
            if now - connection.asked_at >= FORGET_AFTER_S:
                del self._connections[peer]
        counted = Counter(map(address_of, self._connections))
        for name, address in list(self._addresses.items()):
            address.num_connections = counted[name]
            if not counted[name]:
                del self._addresses[name]
