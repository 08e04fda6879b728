"""The servers of a fleet, the clients on each, and which one a client is sent to."""

from __future__ import annotations

import bisect
import random
from dataclasses import dataclass, field
from enum import Enum

from tests.scale.simulation.assumptions import Assumptions

RING_POINTS = 40
"""Points per server on the ring of a proxy's consistent hash."""
BOUND = 1.5
"""For a hash with bounded loads: the most clients of a server, relative to the mean."""
KNOWN, NAMED, ASKED = 8, 3, 4
"""Servers whose room a full server knows; how many of them it names; servers that a client asks in all."""
TELL_S = 1.0
"""How often servers report their room."""
LEAST_FREE = 0.05
"""The least free share of what a server admits with which it is named."""


class Placement(Enum):
    """KEY: the server to which the client's key leads, also if it is full. BOUNDED: the same, but no server gets more
    than `BOUND` times the mean number of clients. HINT: the server to which the key leads; if it is full, one that it
    names according to recent reports, as in `motiongen_server.replicas`. LEAST: the emptier of two random servers at
    first, otherwise as HINT.
    """

    KEY = "key"
    BOUNDED = "key, bounded"
    HINT = "key, then a hint"
    LEAST = "emptier of two, else a hint"


@dataclass(eq=False)
class Client:
    """key: its place on the ring. characters: how many it plays. ends_at: when it leaves by itself."""

    key: float
    characters: int
    ends_at: float
    server: Server | None = None
    moves: int = 0


@dataclass(eq=False)
class Server:
    """characters: their number. clients: in the order of arrival, which a set would not keep. backlog: windows that
    wait as of `looked_at`, for clients that came with little in hand. drains: it accepts no more clients. told: the
    number of characters that it reported at `told_at`.
    """

    number: int
    zone: int
    characters: int = 0
    clients: dict[Client, None] = field(default_factory=dict)
    backlog: float = 0.0
    looked_at: float = 0.0
    drains: bool = False
    told: int = 0
    told_at: float = -TELL_S

    def told_free(self, now: float, given: Assumptions) -> float:
        """The free share of what it admits, as known to the others: it was reported up to a second ago."""
        if now - self.told_at >= TELL_S:
            self.told, self.told_at = self.characters, now
        return 0.0 if self.drains else max(0.0, 1.0 - self.told / (given.admitted * given.capacity))

    def wait_s(self, windows: int, now: float, given: Assumptions) -> float:
        """Queue so many more windows. Returns how long they take, in addition to those of clients that play on."""
        spare = max(given.capacity - self.characters, 0.02 * given.capacity) / given.window_s
        self.backlog = max(0.0, self.backlog - spare * (now - self.looked_at)) + windows
        self.looked_at = now
        return self.backlog / spare


class Fleet:
    """Servers that are up, and how a client gets to one of them. `has_room` plays the part of admission."""

    def __init__(self, given: Assumptions, placement: Placement, dice: random.Random) -> None:
        self.given = given
        self.placement = placement
        self.servers: list[Server] = []
        self._dice = dice
        self._numbers = 0
        self._ring: list[tuple[float, int, Server]] = []

    def add(self, zone: int | None = None) -> Server:
        """Add a server that is ready. zone: by default the one with the fewest servers."""
        self._numbers += 1
        if zone is None:
            counts = [sum(server.zone == each for server in self.servers) for each in range(self.given.zones)]
            zone = counts.index(min(counts))
        server = Server(self._numbers, zone)
        self.servers.append(server)
        for _ in range(RING_POINTS):
            bisect.insort(self._ring, (self._dice.random(), server.number, server))
        return server

    def remove(self, server: Server) -> None:
        """Remove a server; the caller has to place its clients again."""
        self.servers.remove(server)
        self._ring = [point for point in self._ring if point[2] is not server]

    def has_room(self, server: Server, characters: int) -> bool:
        """Whether admission admits so many characters."""
        given = self.given
        return not server.drains and server.characters + characters <= given.admitted * given.capacity

    def place(self, client: Client, now: float = 0.0) -> Server | None:
        """Place a client by the policy, on a server with room; None if it is refused."""
        if not self.servers:
            return None
        if self.placement is Placement.LEAST:
            asked = [self._dice.choice(self.servers) for _ in range(2)]
            first = min(asked, key=lambda server: (server.drains, server.characters))
        else:
            first = self._by_key(client.key)
        if self.has_room(first, client.characters):
            return self._put(client, first)
        if self.placement in (Placement.KEY, Placement.BOUNDED):
            return None
        return self._named(client, [first], now)

    def _named(self, client: Client, asked: list[Server], now: float) -> Server | None:
        """Place a client on a server named by the last one asked, or by that one in turn; None after four servers."""
        while len(asked) < ASKED:
            others = [server for server in self.servers if server is not asked[-1]]
            known = self._dice.sample(others, min(KNOWN, len(others)))
            free = [(server.told_free(now, self.given), server) for server in known]
            drawn = [(self._dice.random() ** (1.0 / share), server) for share, server in free if share >= LEAST_FREE]
            named = [server for _, server in sorted(drawn, key=lambda pair: -pair[0])[:NAMED]]
            following = next((server for server in named if server not in asked), None)
            if following is None:
                return None
            if self.has_room(following, client.characters):
                return self._put(client, following)
            asked.append(following)
        return None

    def _by_key(self, key: float) -> Server:
        at = bisect.bisect(self._ring, key, key=lambda point: point[0])
        most = float("inf")
        if self.placement is Placement.BOUNDED:
            most = BOUND * (1 + sum(len(server.clients) for server in self.servers)) / len(self.servers)
        for step in range(len(self._ring)):
            server = self._ring[(at + step) % len(self._ring)][2]
            if not server.drains and len(server.clients) < most:
                return server
        return self._ring[at % len(self._ring)][2]

    def _put(self, client: Client, server: Server) -> Server:
        client.server = server
        server.clients[client] = None
        server.characters += client.characters
        return server

    def leave(self, client: Client) -> None:
        """Remove a client from its server."""
        server = client.server
        if server is not None:
            del server.clients[client]
            server.characters -= client.characters
            client.server = None

    def loads(self) -> list[float]:
        """Characters of each server, divided by what it can serve in full."""
        return [server.characters / self.given.capacity for server in self.servers]
