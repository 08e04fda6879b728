"""The servers of a fleet, the clients on each, and which one a client is sent to."""

from __future__ import annotations

import bisect
import random
from dataclasses import dataclass, field
from enum import Enum

from tests.scale.simulation.assumptions import Assumptions

RING_POINTS = 40
"""Of each server on the ring of a proxy's consistent hash."""
BOUND = 1.5
"""Of a hash with bounded loads: the clients that a server may have, by the mean of all."""
KNOWN, NAMED, ASKED = 8, 3, 4
"""Servers that one that is full knows the room of, and names of these; that a client asks, the first among them."""
TELL_S = 1.0
"""How often servers tell their room."""
LEAST_FREE = 0.05
"""Of what a server admits, with less of which it is not named."""


class Placement(Enum):
    """KEY: where the client's key leads, and there again if it is full. BOUNDED: the same, but that no server is given
    more than `BOUND` times the mean number of clients. HINT: where it leads, and from a server that is full to one that
    it names, by what servers told a moment ago, as `motiongen_server.replicas` does it. LEAST: the emptier of two at
    random, from the beginning, and else as HINT.
    """

    KEY = "key"
    BOUNDED = "key, bounded"
    HINT = "key, then a hint"
    LEAST = "emptier of two, else a hint"


@dataclass(eq=False)
class Client:
    """key: where on the ring it belongs. characters: that it plays. ends_at: when it goes by itself."""

    key: float
    characters: int
    ends_at: float
    server: Server | None = None
    moves: int = 0


@dataclass(eq=False)
class Server:
    """characters, clients: on it; in the order they came, which a set would not keep. backlog: windows that wait as of
    `looked_at`, of clients that came with little in hand. drains: it takes nobody more. told: its characters as the
    others know them, since `told_at`.
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
        """The share of what it admits that the others take for free: what it said up to a second ago."""
        if now - self.told_at >= TELL_S:
            self.told, self.told_at = self.characters, now
        return 0.0 if self.drains else max(0.0, 1.0 - self.told / (given.admitted * given.capacity))

    def wait_s(self, windows: int, now: float, given: Assumptions) -> float:
        """How long so many more windows take beside those of who plays on, and let them wait with the others."""
        spare = max(given.capacity - self.characters, 0.02 * given.capacity) / given.window_s
        self.backlog = max(0.0, self.backlog - spare * (now - self.looked_at)) + windows
        self.looked_at = now
        return self.backlog / spare


class Fleet:
    """Servers that are up, and the way to one of them. `room` is asked before every placement, as admission is."""

    def __init__(self, given: Assumptions, placement: Placement, dice: random.Random) -> None:
        self.given = given
        self.placement = placement
        self.servers: list[Server] = []
        self._dice = dice
        self._numbers = 0
        self._ring: list[tuple[float, int, Server]] = []

    def add(self, zone: int | None = None) -> Server:
        """A server that is ready. zone: the one with the fewest where it is not given."""
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
        """It is gone; its clients are the caller's to place anew."""
        self.servers.remove(server)
        self._ring = [point for point in self._ring if point[2] is not server]

    def has_room(self, server: Server, characters: int) -> bool:
        """Whether admission lets them in."""
        given = self.given
        return not server.drains and server.characters + characters <= given.admitted * given.capacity

    def place(self, client: Client, now: float = 0.0) -> Server | None:
        """A server with room for a client, by the policy; None where it is refused."""
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
        """One that the server asked last names, or that one in turn; None where four have been asked."""
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
        """The client is on its server no more."""
        server = client.server
        if server is not None:
            del server.clients[client]
            server.characters -= client.characters
            client.server = None

    def loads(self) -> list[float]:
        """Characters of each server, by what it can serve in full."""
        return [server.characters / self.given.capacity for server in self.servers]
