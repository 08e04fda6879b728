"""OtherServers: reports this server's free capacity to others, and knows that of some, for clients refused here."""

from __future__ import annotations

import logging
import random
import re
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress

from motiongen_server.replicas.directory import Directory, Replica
from motiongen_server.replicas.hint import OtherServer
from motiongen_server.snapshots.store import StoreFailed

_log = logging.getLogger(__name__)

EVERY_S = 1.0
OLD_S = 3.0
"""What was learned longer ago than this is not passed on: the store is unreachable."""
MOST_NAMED = 3
LEAST_FREE = 0.05
"""Share of a server's capacity: with less, clients sent there would be refused there too."""
ROUTING_KEY = "x-motiongen-key"
"""Metadata of calls, by which proxies choose a server."""
# Keys that our clients draw at random. Others may be names that an application has chosen: they are not passed on.
_DRAWN_KEY = re.compile(r"[0-9a-f]{16}")


class OtherServers:
    """`start` it once there is something to report. `note_call` and `named` are for the event loop; the rest is done
    on a thread."""

    def __init__(
        self,
        directory: Directory,
        address: str = "",
        clock: Callable[[], float] = time.monotonic,
        draw: Callable[[], float] = random.random,
    ) -> None:
        """address: where clients reach this server, "" if only through a proxy. draw: random numbers from 0 to 1."""
        self._directory = directory
        self._address = address
        self._clock = clock
        self._draw = draw
        self._name = secrets.token_hex(8)
        self._routing_key = ""
        self._free_shares: Callable[[], Mapping[str, float]] = dict
        self._known: list[Replica] = []
        self._known_at = 0.0
        self._is_away = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="motiongen-replicas", daemon=True)

    def start(self, free_shares: Callable[[], Mapping[str, float]]) -> None:
        """Begin to exchange every second. free_shares: by model; called on the thread."""
        self._free_shares = free_shares
        self._thread.start()

    def note_call(self, metadata: object) -> None:
        """A client has called with this metadata; if that has a key, a proxy routes to this server by it."""
        for name, value in metadata or ():  # type: ignore[attr-defined]
            if name == ROUTING_KEY and isinstance(value, str) and _DRAWN_KEY.fullmatch(value):
                self._routing_key = value

    @property
    def num_known(self) -> int:
        """How many others' free capacity is known: eight at most."""
        return len(self._recent)

    @property
    def _recent(self) -> list[Replica]:
        return self._known if self._clock() - self._known_at < OLD_S else []

    def named(self, model_id: str) -> tuple[OtherServer, ...]:
        """Servers with room for a session of a model, at most three.

        Drawn at random, weighted by their room, so that clients refused within the same second go to different servers.
        """
        free = [
            (share, each)
            for each in self._recent
            if (each.address or each.routing_key) and (share := each.free_shares.get(model_id, 0.0)) >= LEAST_FREE
        ]
        # The order of a weighted draw without replacement: Efraimidis and Spirakis 2006, algorithm A.
        drawn = sorted(free, key=lambda pair: self._draw() ** (1.0 / pair[0]), reverse=True)
        return tuple(OtherServer(each.address, each.routing_key) for _, each in drawn[:MOST_NAMED])

    def exchange(self) -> None:
        """Report this server, and learn of others."""
        try:
            own = Replica(self._name, self._address, self._routing_key, self._free_shares())
            known = self._directory.exchange(own)
        except StoreFailed as error:
            if not self._is_away:
                _log.warning("the free capacity of other servers is not known: %s", error)
            self._is_away = True
            return
        except Exception:  # if the thread ended, no other server would know of this one any more
            if not self._is_away:
                _log.exception("the free capacity of other servers is not known")
            self._is_away = True
            return
        self._known, self._known_at, self._is_away = known, self._clock(), False

    def _work(self) -> None:
        while True:
            self.exchange()
            if self._stop.wait(EVERY_S):
                return

    def close(self) -> None:
        """Remove this server's report and end. Waits a moment for a store that does not answer."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(2 * EVERY_S)
        with suppress(Exception):  # the report expires soon anyway
            self._directory.leave(self._name)
        self._directory.close()
