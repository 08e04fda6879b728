"""A directory of servers with contents given by a test."""

from __future__ import annotations

from motiongen_server.replicas.directory import Replica
from motiongen_server.snapshots.store import StoreFailed


class Told:
    """others: the servers that each exchange returns; own: what it was sent; is_away: it does not answer."""

    def __init__(self, *others: Replica) -> None:
        self.others = list(others)
        self.own: list[Replica] = []
        self.left: list[str] = []
        self.is_away = self.is_closed = False

    def exchange(self, own: Replica) -> list[Replica]:
        if self.is_away:
            raise StoreFailed("it is away")
        self.own.append(own)
        return self.others

    def leave(self, name: str) -> None:
        if self.is_away:
            raise StoreFailed("it is away")
        self.left.append(name)

    def close(self) -> None:
        self.is_closed = True
