"""Peers: what all streams and calls from one address may have together."""

from __future__ import annotations

from collections import Counter

from motiongen_server.engine.types import Priority
from motiongen_server.rpc.event_errors import peer_clips, peer_heroes, peer_sessions
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.token_bucket import Share, TokenBucket

SESSION_WEIGHTS = {Priority.HERO: 4, Priority.NEAR: 2, Priority.CROWD: 1, Priority.BATCH: 1}
"""What a session of each class counts for: a hero is planned anew far more often."""
MOST_IDLE = 1024
"""Peers that have nothing open are remembered for what they owe, up to so many."""


class Peer:
    """One address."""

    def __init__(self, limits: PeerLimits, now: float) -> None:
        self.limits = limits
        self.events = TokenBucket(limits.events_per_second, now)
        self.prompts = TokenBucket(limits.prompts_per_second, now)
        self.calls = TokenBucket(limits.calls_per_second, now)
        self.num_streams = 0
        self._sessions: Counter[Priority] = Counter()
        self._clip_samples = 0

    @property
    def session_weight(self) -> int:
        """Of the sessions that it has."""
        return sum(SESSION_WEIGHTS[priority] * count for priority, count in self._sessions.items())

    def is_idle(self, now: float) -> bool:
        """Whether nothing would be lost if it were forgotten."""
        is_open = self.num_streams or self._clip_samples or self._sessions.total()
        return not is_open and all(each.is_full(now) for each in (self.events, self.prompts, self.calls))

    @property
    def num_sessions(self) -> int:
        """That it has open, of all classes."""
        return self._sessions.total()

    def prompts_share(self, now: float) -> Share:
        """A session's, or a clip's, part of the prompts."""
        return Share(self.prompts, lambda: self.num_sessions, now)

    def place(self, priority: Priority, now: float) -> Place:
        """A place for a session, held until it is released. Raises EventRefused where there is none."""
        limits = self.limits
        if priority is Priority.HERO and self._sessions[priority] >= limits.heroes:
            raise peer_heroes(limits.heroes)
        if self.session_weight + SESSION_WEIGHTS[priority] > limits.session_weight:
            raise peer_sessions(limits.session_weight)
        self._sessions[priority] += 1
        return Place(self, priority, now)

    def leave(self, priority: Priority) -> None:
        """A session of that class is over."""
        self._sessions[priority] -= 1

    def begin_clip(self, num_samples: int) -> None:
        """Note samples that are about to be made. Raises EventRefused where it has as many as it may."""
        if self._clip_samples + num_samples > self.limits.clip_samples:
            raise peer_clips(self.limits.clip_samples)
        self._clip_samples += num_samples

    def end_clip(self, num_samples: int) -> None:
        """They are made, or given up."""
        self._clip_samples -= num_samples


class Place:
    """A session's place among those of its peer."""

    __slots__ = ("_is_held", "_priority", "peer", "prompts")

    def __init__(self, peer: Peer, priority: Priority, now: float) -> None:
        self.prompts = peer.prompts_share(now)
        self.peer = peer
        self._priority = priority
        self._is_held = True

    def release(self) -> None:
        """The session is over. May be called again."""
        if self._is_held:
            self._is_held = False
            self.peer.leave(self._priority)


class Peers:
    """All addresses that have something open, or owe something. Lives on the event loop."""

    def __init__(self, limits: PeerLimits | None = None) -> None:
        self._limits = limits or PeerLimits()
        self._peers: dict[str, Peer] = {}

    def find(self, peer: str, now: float) -> Peer:
        """The peer of a call. peer: as gRPC names it."""
        address = address_of(peer)
        found = self._peers.get(address)
        if found is None:
            if len(self._peers) >= MOST_IDLE:
                self._peers = {name: held for name, held in self._peers.items() if not held.is_idle(now)}
            found = self._peers[address] = Peer(self._limits, now)
        return found


def address_of(peer: str) -> str:
    """A peer's name without its port: ipv4:10.0.0.7:55000 -> ipv4:10.0.0.7; those on unix sockets are one."""
    if peer.startswith("unix"):
        return "unix"
    return peer.rpartition(":")[0] or peer
