"""A store that is slow, broken, or away: no session is forgotten, and all are informed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest

from motiongen_server.snapshots import writer
from motiongen_server.snapshots.record import RecordRefused, read_record
from motiongen_server.snapshots.store import Lease, StoreFailed
from motiongen_server.snapshots.writer import SnapshotWriter
from tests.server.snapshots.kept import Heard, Store
from tests.server.snapshots.records import a_record
from tests.waiting import until

A, B = Lease("a", 1), Lease("b", 1)


class Pressed(Store):
    """During each of its first saves, all sessions are saved again and time passes, though no call takes too long.

    seen: for each save, how many sessions have a record, and whether the writer considered the store failing.
    """

    def __init__(self, leases: Sequence[Lease]) -> None:
        super().__init__()
        self.now = 0.0
        self.saving: SnapshotWriter | None = None
        self.leases = leases
        self.seen: list[tuple[int, bool]] = []

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        assert self.saving is not None
        self.now += 1.5
        if self.num_saves < 20:
            for lease in self.leases:
                self.saving.save(lease, a_record(1, num_frames=1))
        answers = super().save(records)
        self.seen.append((len(self.records), self.saving.is_failing))
        return answers


@pytest.mark.usefixtures("rare_renewals")
def test_sessions_take_turns_and_too_long_a_wait_is_reported_as_failure(
    heard: Heard, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writer, "MAX_LAG_S", 2.0)
    leases = [Lease(f"session-{number}", 1) for number in range(100)]
    store = Pressed(leases)
    saving = SnapshotWriter(store, heard, lambda: store.now)
    store.saving = saving
    with saving._lock:
        saving._waiting.update((lease, (a_record(1, num_frames=1), 0.0)) for lease in leases)
        saving._leases.update(leases)
        saving._news.notify()
    until(lambda: len(store.seen) > 10)
    assert store.seen[1] == (100, False), "the second call saves those for which the first had no room"
    assert store.seen[4][1], "each session waits for more than two seconds"
    assert "failed" in heard.said
    until(lambda: not saving._waiting)
    saving.close()


@pytest.mark.usefixtures("rare_renewals")
def test_store_counts_as_failing_while_a_record_waits_too_long(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    saving.save(B, a_record(1))
    until(lambda: heard.said)
    monkeypatch.setattr(writer, "MAX_LAG_S", -1.0)
    store.gate.clear()
    saving.save(A, a_record(1))
    until(lambda: store.num_saves == 2)
    saving._is_failing = True
    saving._renew()
    assert store.renewed == [B]
    assert saving.is_failing
    store.gate.set()
    until(lambda: not saving._waiting)
    saving._renew()
    assert not saving.is_failing


def test_recovery_of_the_store_is_noticed_without_any_session(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    saving.save(A, a_record(1))
    until(lambda: heard.said)
    store.fails = True
    until(lambda: saving.is_failing)
    saving.release(A)
    store.fails = False
    until(lambda: not saving.is_failing)


def test_unexpected_error_of_the_store_is_reported_and_tolerated(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    def break_down() -> None:
        raise TypeError("an option that there is not")

    with monkeypatch.context() as patched:
        patched.setattr(store, "_check", break_down)
        saving.save(A, a_record(1))
        until(lambda: "failed" in heard.said)
    until(lambda: not saving.is_failing)
    assert read_record(store.records["a"][1]).taken_seq == 1


def test_session_that_grew_too_large_is_not_reported_renewed_at_recovery(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    for lease in (A, B):
        saving.save(lease, a_record(1, num_frames=1))
    until(lambda: len(store.records) == 2 and not saving._waiting)
    monkeypatch.setattr(writer, "write_record", _refuse)
    saving.save(A, a_record(2, num_frames=1))
    until(lambda: ("lost", A) in heard.said)
    store.fails = True
    until(lambda: saving.is_failing)
    store.fails = False
    renewed = until(lambda: [said for said in heard.said if isinstance(said, tuple) and said[0] == "renewed"])
    assert renewed == [("renewed", B)]


def test_session_too_large_to_save_is_not_reported_gone_by_an_empty_store(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    saving.save(B, a_record(1, num_frames=1))
    until(lambda: heard.said)
    monkeypatch.setattr(writer, "write_record", _refuse)
    saving.save(A, a_record(1, num_frames=1))
    until(lambda: ("lost", A) in heard.said)
    store.records.clear()
    until(lambda: heard.said.count(("lost", A)) > 1 and ("gone", B) in heard.said)
    assert ("gone", A) not in heard.said


def test_store_that_never_answers_is_reported_at_the_next_save(store: Store, heard: Heard) -> None:
    """For example a disk that hangs: the writing thread is inside that call, and cannot report anything."""
    now = [0.0]
    saving = SnapshotWriter(store, heard, lambda: now[0])
    store.gate.clear()
    saving.save(A, a_record(1))
    until(lambda: store.num_saves)
    now[0] += 2 * writer.MAX_LAG_S
    saving.save(A, a_record(2))
    assert heard.said == []
    now[0] += 1.0
    saving.save(B, a_record(1))
    saving.save(B, a_record(2))
    assert heard.said == ["failed"]
    assert saving.is_failing
    store.gate.set()
    until(lambda: not saving.is_failing)
    saving.close()


class Full(Store):
    """Accepts no record, new or old, until one is dropped, but renews what it has."""

    is_full = False

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        if self.is_full:
            raise StoreFailed("OOM command not allowed")
        return super().save(records)

    def drop(self, leases: Sequence[Lease]) -> None:
        super().drop(leases)
        self.is_full = False


@pytest.fixture
def full(heard: Heard) -> Iterator[tuple[Full, SnapshotWriter]]:
    """A store with the records of two sessions, one of which cannot be saved any more, and its writer."""
    store = Full()
    saving = SnapshotWriter(store, heard)
    saving.save(A, a_record(1))
    saving.save(B, a_record(1))
    until(lambda: len(heard.said) == 2)
    store.is_full = True
    saving.save(A, a_record(2))
    until(lambda: "failed" in heard.said)
    yield store, saving
    store.is_full = False
    saving.close()


def test_full_store_recovers_once_a_session_is_dropped(full: tuple[Full, SnapshotWriter]) -> None:
    store, saving = full
    saving.drop(B)
    until(lambda: not saving.is_failing)
    assert store.dropped == [B]
    assert read_record(store.records["a"][1]).taken_seq == 2


def test_full_store_renews_its_records_but_counts_as_failing(full: tuple[Full, SnapshotWriter], heard: Heard) -> None:
    store, saving = full
    del store.renewed[:]
    until(lambda: store.renewed.count(A) >= 3 and store.renewed.count(B) >= 3)
    assert saving.is_failing
    assert heard.said[2:] == ["failed"], "clients were told once, and there is no recovery to report"
    store.others = {"b": 2}
    until(lambda: ("fenced", B) in heard.said)


def _refuse(_: object) -> bytes:
    raise RecordRefused("it is too big")
