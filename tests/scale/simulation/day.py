"""A day of a fleet: a heap of events, from the first arrival to the last."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from tests.scale.simulation.assumptions import Assumptions, Day
from tests.scale.simulation.fleet import Client, Fleet, Placement, Server

SAMPLE_S = 5.0
USUAL, USUAL_DAY = Assumptions(), Day()


@dataclass
class Sample:
    """The fleet at one time: its servers and characters; mean, 99th percentile and maximum of the servers' loads."""

    at: float
    servers: int
    characters: int
    mean: float
    p99: float
    most: float
    refused: int


@dataclass
class Outcome:
    """The results. Times in seconds; held: character-seconds without a frame, played: with one.

    opened, refused, given_up: numbers of clients; waited: how long clients that were refused at first waited until they
    were admitted. moved: clients that moved to another server; away: how long each of them held its pose meanwhile.
    """

    opened: int = 0
    refused: int = 0
    given_up: int = 0
    waited: list[float] = field(default_factory=list)
    moved: int = 0
    away: list[float] = field(default_factory=list)
    held: float = 0.0
    late: float = 0.0
    played: float = 0.0
    upgraded_s: float = 0.0
    samples: list[Sample] = field(default_factory=list)


class Simulation:
    """One day. seed: of all random choices."""

    def __init__(
        self, servers: int, placement: Placement, given: Assumptions = USUAL, day: Day = USUAL_DAY, seed: int = 1
    ) -> None:
        self.given, self.day = given, day
        self._dice = random.Random(seed)
        self.fleet = Fleet(given, placement, random.Random(seed + 1))
        self.outcome = Outcome()
        self._heap: list[tuple[float, int, Callable[[float], None]]] = []
        self._order = itertools.count()
        self._starting = 0
        self._generation = 0
        self._failed_zone: int | None = None
        self._to_upgrade: list[Server] = []
        self._upgrading = 0
        self._asked_before = 0
        self._rate = servers * given.capacity * given.target / given.characters / given.life_s
        for _ in range(servers):
            self.fleet.add()

    def run(self) -> Outcome:
        """Run to the end of the day."""
        given, day = self.given, self.day
        for _ in range(int(self._rate * given.life_s)):  # clients that are there from the beginning
            self._try_to_open(self._client(0.0), 0.0, 0.0)
        self._expect_arrival(0.0)
        self._at(day.wave_at, self._change_rate)
        self._at(day.wave_at + day.wave_s, self._change_rate)
        self._at(SAMPLE_S, self._sample)
        self._at(given.scale_every_s, self._scale)
        self._at(day.zone_fails_at, self._fail_zone)
        self._at(day.zone_back_at, self._zone_is_back)
        self._at(day.upgrade_at, self._begin_upgrade)
        while self._heap:
            now, _, event = heapq.heappop(self._heap)
            if now > day.ends_at:
                break
            event(now)
        return self.outcome

    def _at(self, when: float, event: Callable[[float], None]) -> None:
        heapq.heappush(self._heap, (when, next(self._order), event))

    # ---- clients ----------------------------------------------------------------------------------------------------

    def _client(self, now: float) -> Client:
        stop = 1.0 / self.given.characters
        characters = 1 + int(math.log(1.0 - self._dice.random()) / math.log(1.0 - stop))
        return Client(self._dice.random(), characters, now + self._dice.expovariate(1.0 / self.given.life_s))

    def _change_rate(self, now: float) -> None:
        """Begin or end the wave. Arrivals are memoryless, so the next one is drawn again."""
        self._generation += 1
        self._expect_arrival(now)

    def _expect_arrival(self, now: float) -> None:
        day = self.day
        rate = self._rate * (day.wave if day.wave_at <= now < day.wave_at + day.wave_s else 1.0)
        self._at(now + self._dice.expovariate(rate), partial(self._arrive, self._generation))

    def _arrive(self, generation: int, now: float) -> None:
        if generation != self._generation:
            return  # it was drawn for an earlier rate
        self._expect_arrival(now)
        self.outcome.opened += now >= self.day.warm_until
        self._try_to_open(self._client(now), now, now)

    def _try_to_open(self, client: Client, asked_at: float, now: float) -> None:
        if self.fleet.place(client, now) is not None:
            if now > asked_at:
                self.outcome.waited.append(now - asked_at)
            self._at(client.ends_at + now - asked_at, lambda _: self.fleet.leave(client))
            return
        self.outcome.refused += now == asked_at and now >= self.day.warm_until
        if now - asked_at >= self.given.patience_s:
            self.outcome.given_up += 1
            return
        again = now + self.given.retry_s * self._dice.uniform(0.5, 1.5)
        self._at(again, partial(self._try_to_open, client, asked_at))

    def _move_all(self, server: Server, now: float, lost: bool) -> None:
        """Move its clients elsewhere. lost: the server is gone; otherwise it serves them until they have moved."""
        for client in list(server.clients):
            self.fleet.leave(client)
            least, most = self.given.away_s
            away = self._dice.uniform(least, most) if lost else least
            self.outcome.moved += 1
            self._at(now + away, partial(self._take_over, client, now))

    def _take_over(self, client: Client, lost_at: float, now: float) -> None:
        if client.ends_at <= now:
            return
        server = self.fleet.place(client, now)
        if server is None:
            again = now + 0.5 * self.given.retry_s * self._dice.uniform(0.5, 1.5)
            self._at(again, partial(self._take_over, client, lost_at))
            return
        done_at = now + server.wait_s(client.characters, now, self.given)
        away = max(0.0, done_at - lost_at - self.given.lookahead_s)
        self.outcome.away.append(away)
        self.outcome.held += away * client.characters

    # ---- servers ----------------------------------------------------------------------------------------------------

    def _scale(self, now: float) -> None:
        """Scale like the autoscaler of Kubernetes: by the mean load, with a limited rate of growth."""
        given, servers = self.given, self.fleet.servers
        there = len(servers) + self._starting
        loads = self.fleet.loads()
        wanted = math.ceil(sum(loads) / given.target) if loads else there
        step = max(2, math.ceil(given.growth * there * given.scale_every_s / 60))
        for _ in range(min(step, max(0, wanted - there))):
            self._start(now)
        self._at(now + given.scale_every_s, self._scale)

    def _start(self, now: float, is_upgrade: bool = False) -> None:
        self._starting += 1

        def ready(then: float) -> None:
            self._starting -= 1
            zones = [each for each in range(self.given.zones) if each != self._failed_zone]
            fewest = min(zones, key=lambda zone: sum(server.zone == zone for server in self.fleet.servers))
            self.fleet.add(fewest)
            if is_upgrade:
                self._replace_one(then)

        self._at(now + self.given.start_s, ready)

    def _fail_zone(self, now: float) -> None:
        self._failed_zone = 0
        for server in [each for each in self.fleet.servers if each.zone == 0]:
            self.fleet.remove(server)
            self._move_all(server, now, lost=True)

    def _zone_is_back(self, _now: float) -> None:
        self._failed_zone = None

    def _begin_upgrade(self, now: float) -> None:
        self._to_upgrade = list(self.fleet.servers)
        for _ in range(max(1, int(self.given.surge * len(self._to_upgrade)))):
            self._upgrading += 1
            self._start(now, is_upgrade=True)

    def _replace_one(self, now: float) -> None:
        """A new server is ready: an old one leaves, and the next new one is started."""
        if self._to_upgrade:
            old = self._to_upgrade.pop()
            old.drains = True
            self._move_all(old, now, lost=False)
            self.fleet.remove(old)
        if self._to_upgrade:
            self._start(now, is_upgrade=True)
            return
        self._upgrading -= 1
        if not self._upgrading:
            self.outcome.upgraded_s = now - self.day.upgrade_at

    def _sample(self, now: float) -> None:
        self._at(now + SAMPLE_S, self._sample)
        loads = np.array(self.fleet.loads())
        characters = sum(server.characters for server in self.fleet.servers)
        asked, outcome = self.outcome.refused, self.outcome
        outcome.samples.append(
            Sample(
                now,
                len(loads),
                characters,
                float(loads.mean()),
                float(np.percentile(loads, 99)),
                float(loads.max()),
                asked - self._asked_before,
            )
        )
        self._asked_before = asked
        if now >= self.day.warm_until:
            outcome.played += characters * SAMPLE_S
            outcome.late += float(np.maximum(loads - 1.0, 0.0).sum()) * self.given.capacity * SAMPLE_S
