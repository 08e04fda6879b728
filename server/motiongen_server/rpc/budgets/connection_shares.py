"""ConnectionShares: what each address may do per second, in equal shares for its connections.

Clients behind one proxy or address translation share an address; none of them can use up what the others may do.
"""

from __future__ import annotations

from collections import Counter

from motiongen_server.rpc.budgets.peers import address_of
from motiongen_server.rpc.budgets.token_bucket import Share, TokenBucket

FORGET_AFTER_S = 2.0
"""A connection that does nothing for this long loses its share, and its debt is forgotten."""


class Address:
    """What one address may do, how many connections share it, and how many of their requests wait."""

    def __init__(self, rate: float, now: float) -> None:
        self.bucket = TokenBucket(rate, now)
        self.num_connections = 0
        self.num_waiting = 0


class Connection:
    """A connection's share of what its address may do, and how many of its requests wait."""

    def __init__(self, address: Address, now: float) -> None:
        address.num_connections += 1
        self.address = address
        self.share = Share(address.bucket, lambda: address.num_connections, now)
        self.used_at = now
        self.num_waiting = 0


class ConnectionShares:
    """The connections of all addresses. Lives on one event loop; now: monotonic seconds."""

    def __init__(self, rate: float, now: float) -> None:
        """rate: what one address may do, per second."""
        self._rate = rate
        self._addresses: dict[str, Address] = {}
        self._connections: dict[str, Connection] = {}
        self._swept_at = now

    @property
    def num_addresses(self) -> int:
        """Addresses that are kept."""
        return len(self._addresses)

    @property
    def num_connections(self) -> int:
        """Connections that are kept."""
        return len(self._connections)

    def of(self, peer: str, now: float) -> Connection:
        """The connection of a caller that does something now. peer: the caller, as gRPC names it."""
        if now - self._swept_at >= FORGET_AFTER_S:
            self._forget_silent(now)
        connection = self._connections.get(peer)
        if connection is None:
            name = address_of(peer)
            address = self._addresses.get(name)
            if address is None:
                address = self._addresses[name] = Address(self._rate, now)
            connection = self._connections[peer] = Connection(address, now)
        connection.used_at = now
        return connection

    def _forget_silent(self, now: float) -> None:
        self._swept_at = now
        self._connections = {
            peer: each
            for peer, each in self._connections.items()
            if each.num_waiting or now - each.used_at < FORGET_AFTER_S
        }
        counted = Counter(map(address_of, self._connections))
        for name, address in list(self._addresses.items()):
            address.num_connections = counted[name]
            if not counted[name] and address.bucket.is_full(now):
                del self._addresses[name]
