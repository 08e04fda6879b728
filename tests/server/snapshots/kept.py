"""A store in memory, and a receiver of the writer's reports."""

from __future__ import annotations

import threading
from collections.abc import Sequence

from motiongen_server.snapshots.listener import Written
from motiongen_server.snapshots.store import Held, Lease, Renewal, StoreFailed


class Store:
    """Keeps records in memory. gate: saves wait for it; fails: every call fails; others: epochs raised by others."""

    def __init__(self) -> None:
        self.records: dict[str, tuple[int, bytes]] = {}
        self.gate = threading.Event()
        self.gate.set()
        self.fails = False
        self.others: dict[str, int] = {}
        self.num_saves = 0
        self.dropped: list[Lease] = []
        self.renewed: list[Lease] = []
        self.is_closed = False

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        self.num_saves += 1
        self.gate.wait()
        self._check()
        answers = [self.others.get(lease.name, 0) <= lease.epoch for lease, _ in records]
        for (lease, data), is_kept in zip(records, answers, strict=True):
            if is_kept:
                self.records[lease.name] = lease.epoch, data
        return answers

    def read(self, name: str) -> Held | None:
        self._check()
        return Held(*self.records[name]) if name in self.records else None

    def take(self, lease: Lease, holder: str) -> Held | None:
        self._check()
        epoch, data = self.records.get(lease.name, (0, b""))
        if epoch != lease.epoch:
            return None
        self.records[lease.name] = epoch + 1, data
        return Held(epoch + 1, data)

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        self._check()
        self.renewed += leases
        fenced = [self.others.get(lease.name, 0) > lease.epoch for lease in leases]
        there = [lease.name in self.records for lease in leases]
        kept = [Renewal.KEPT if each else Renewal.GONE for each in there]
        return [Renewal.FENCED if lost else other for lost, other in zip(fenced, kept, strict=True)]

    def drop(self, leases: Sequence[Lease]) -> None:
        self._check()
        self.dropped += leases

    def close(self) -> None:
        self.is_closed = True

    def _check(self) -> None:
        if self.fails:
            raise StoreFailed("away")


class Heard:
    """The writer's reports, in order."""

    def __init__(self) -> None:
        self.said: list[object] = []

    def written(self, written: list[Written]) -> None:
        self.said += written

    def renewed(self, leases: list[Lease]) -> None:
        self.said.append(("renewed", *leases))

    def fenced(self, leases: list[Lease]) -> None:
        self.said.append(("fenced", *leases))

    def lost(self, leases: list[Lease]) -> None:
        self.said.append(("lost", *leases))

    def gone(self, leases: list[Lease]) -> None:
        self.said.append(("gone", *leases))

    def failed(self) -> None:
        self.said.append("failed")
