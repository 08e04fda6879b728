"""CheckBudget: limits how many unknown signed tokens each connection may have checked.

Anybody can make up an invalid token, and only a check shows that it is one. So the check is charged to the token's
connection before the token is read, and refunded if the token is valid. Nobody else pays: clients behind a proxy share
an address, and what some of them owe for calls must not keep out those with a valid token.
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
"""Failed checks, of all connections together. They take 7 % of a Zen 5 core, whatever the length of the tokens."""
CHARACTERS_A_CHECK = 1024.0
"""A token costs one more check for each so many characters: reading 8 KB takes six times as long as the signature."""
FORGET_AFTER_S = 2.0
"""A connection that has sent no new token for this long loses its share, and its debt is forgotten."""


class _Part:
    """An address's share of the checks, or a connection's share of its address's."""

    def __init__(self, of: Bucket, num_users: Callable[[], int], now: float) -> None:
        self.share = Share(of, num_users, now)
        self.num_connections = 0
        self.asked_at = now


class CheckBudget:
    """Addresses have equal shares, which their connections share equally; a connection within its share is not refused.

    A new connection has a share at once: opening one costs more than a check does. Lives on one event loop.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._bucket = TokenBucket(CHECKS_PER_SECOND, clock())
        self._addresses: dict[str, _Part] = {}
        self._connections: dict[str, _Part] = {}
        self._swept_at = clock()

    def charge(self, peer: str, num_characters: int) -> Callable[[], None]:
        """Charge the check of a token of that length; returns the function that refunds it. peer: as gRPC names it.

        Raises StreamRefused while the connection owes for invalid tokens.
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
