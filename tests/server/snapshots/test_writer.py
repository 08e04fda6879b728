"""The way to the store: the newest record of each session, whatever the store does meanwhile."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence

import pytest

from motiongen_server.snapshots import writer
from motiongen_server.snapshots.record import MAX_BYTES, read_record
from motiongen_server.snapshots.store import Held, Lease, Renewal, StoreFailed
from motiongen_server.snapshots.writer import SnapshotWriter, Written
from tests.server.snapshots.records import a_record
from tests.waiting import LIMIT_S, until

A, B = Lease("a", 1), Lease("b", 1)


class Store:
    """Keeps records in memory. gate: saves wait for it; fails: it does nothing; others: epochs that others raised."""

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

    def read(self, name: str) -> bytes | None:
        self._check()
        return self.records[name][1] if name in self.records else None

    def take(self, name: str, holder: str) -> Held | None:
        self._check()
        return Held(2, b"") if name in self.records else None

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
    """What the writer says, in order."""

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

    def failed(self) -> None:
        self.said.append("failed")


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "RETRY_S", 0.01)
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.02)
    monkeypatch.setattr(writer, "MAX_LAG_S", LIMIT_S)  # a busy machine is no slow store


@pytest.fixture
def rare_renewals(short_waits: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """None comes by itself: only a write finds out that the store fails."""
    monkeypatch.setattr(writer, "RENEW_EVERY_S", LIMIT_S)


@pytest.fixture
def store() -> Store:
    return Store()


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def saving(store: Store, heard: Heard) -> Iterator[SnapshotWriter]:
    saving = SnapshotWriter(store, heard)
    yield saving
    store.gate.set()
    saving.close()


def test_what_is_saved_is_told_with_the_events_that_it_holds(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    saving.save(A, a_record(7))
    until(lambda: heard.said)
    assert heard.said == [Written(A, 7)]
    assert read_record(store.records["a"][1]).taken_seq == 7
    assert saving.lag_s == 0.0


def test_a_slow_store_is_given_only_the_newest_of_each_session(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    store.gate.clear()
    saving.save(A, a_record(1))
    until(lambda: store.num_saves)
    for number in range(2, 50):
        saving.save(A, a_record(number))
        saving.save(B, a_record(number))
    assert saving.lag_s > 0
    store.gate.set()
    until(lambda: len(heard.said) == 3)
    assert heard.said == [Written(A, 1), Written(A, 49), Written(B, 49)]


def test_the_thread_that_writes_lets_others_go_first(saving: SnapshotWriter) -> None:
    writes, own = saving._thread.native_id, threading.get_native_id()
    assert writes is not None
    least = min(19, os.getpriority(os.PRIO_PROCESS, own) + writer.NICENESS)
    until(lambda: os.getpriority(os.PRIO_PROCESS, writes) == least)


@pytest.mark.usefixtures("rare_renewals")
def test_who_was_written_since_the_last_renewal_needs_none(store: Store, heard: Heard, saving: SnapshotWriter) -> None:
    saving.save(A, a_record(1))
    until(lambda: heard.said)
    saving._renew()
    assert store.renewed == []
    saving._renew()
    assert store.renewed == [A]


@pytest.mark.usefixtures("rare_renewals")
def test_a_store_that_fails_is_told_of_once_and_when_it_is_well_again(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    saving.save(A, a_record(1))
    saving.save(B, a_record(1))
    until(lambda: len(heard.said) == 2)
    store.fails = True
    saving.save(A, a_record(2))
    until(lambda: len(heard.said) == 3)
    assert heard.said[2] == "failed"
    assert saving.is_failing
    del store.records["b"]  # it was away because it was started anew
    store.fails = False
    until(lambda: not saving.is_failing and saving.lag_s == 0.0 and ("lost", B) in heard.said)
    assert heard.said.count("failed") == 1
    assert ("renewed", A) in heard.said
    assert read_record(store.records["a"][1]).taken_seq == 2, "what waited was written"


def test_what_was_written_too_late_to_be_relied_upon_is_told_once_the_store_is_well(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    saving.save(A, a_record(3))
    until(lambda: heard.said)
    monkeypatch.setattr(writer, "MAX_LAG_S", -1.0)
    saving.save(A, a_record(5))
    until(lambda: "failed" in heard.said)
    until(lambda: Written(A, 5) in heard.said)
    assert heard.said == [Written(A, 3), "failed", ("renewed", A), Written(A, 5)]


def test_who_is_fenced_is_told_with_a_write_or_soon_without_one(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    saving.save(A, a_record(1))
    saving.save(B, a_record(1))
    until(lambda: len(heard.said) == 2)
    store.others = {"a": 2}
    saving.save(A, a_record(2))
    until(lambda: ("fenced", A) in heard.said)
    store.others["b"] = 2
    until(lambda: ("fenced", B) in heard.said)
    assert read_record(store.records["a"][1]).taken_seq == 1


def test_a_session_that_is_too_big_is_told_to_be_lost_and_logged_once(
    heard: Heard, saving: SnapshotWriter, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(1, 4):
        saving.save(A, a_record(number, num_frames=MAX_BYTES // 48 + 1))
        until(lambda: saving.lag_s == 0 and ("lost", A) in heard.said)
    saving.save(B, a_record(1, num_frames=MAX_BYTES // 48 + 1))
    until(lambda: ("lost", B) in heard.said)
    said = [record.levelname for record in caplog.records if "is not saved" in record.getMessage()]
    assert said == ["WARNING", "WARNING"], "one of each session: clients can bring it about"


def test_what_was_dropped_is_dropped_also_by_a_store_that_was_away(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    store.fails = True
    saving.drop(A)
    until(lambda: "failed" in heard.said)
    assert not store.dropped
    store.fails = False
    until(lambda: store.dropped)
    assert store.dropped == [A]


def test_the_end_writes_what_waits_and_waits_for_no_store_that_fails(store: Store, heard: Heard) -> None:
    saving = SnapshotWriter(store, heard)
    saving.save(A, a_record(3))
    saving.release(A)
    saving.close()
    assert store.records.keys() == {"a"}
    assert store.is_closed
    again = SnapshotWriter(store, heard)
    store.fails = True
    again.save(B, a_record(3))
    again.close()
    assert store.records.keys() == {"a"}


def test_taking_over_says_what_the_store_says(store: Store, heard: Heard, saving: SnapshotWriter) -> None:
    saving.save(A, a_record(3))
    until(lambda: heard.said)
    assert saving.take("a").result() == Held(2, b"")
    assert saving.take("c").result() is None
    store.fails = True
    with pytest.raises(StoreFailed):
        saving.take("a").result()
