"""The snapshot writer saves the newest record of each session, whatever the store does meanwhile."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence

import pytest

from motiongen_server.snapshots import writer
from motiongen_server.snapshots.listener import Written
from motiongen_server.snapshots.record import MAX_BYTES, read_record
from motiongen_server.snapshots.store import Lease, StoreFailed
from motiongen_server.snapshots.writer import MOST_AT_ONCE, SnapshotWriter
from tests.server.snapshots.kept import Heard, Store
from tests.server.snapshots.records import a_record
from tests.waiting import until

A, B = Lease("a", 1), Lease("b", 1)


def test_saved_record_is_reported_with_its_last_event(store: Store, heard: Heard, saving: SnapshotWriter) -> None:
    saving.save(A, a_record(7))
    until(lambda: heard.said)
    assert heard.said == [Written(A, 7)]
    assert read_record(store.records["a"][1]).taken_seq == 7
    assert saving.lag_s == 0.0


def test_slow_store_is_given_only_the_newest_record_of_each_session(
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
    assert heard.said == [Written(A, 1), Written(B, 49), Written(A, 49)]


def test_writing_thread_has_low_priority(saving: SnapshotWriter) -> None:
    writes, own = saving._thread.native_id, threading.get_native_id()
    assert writes is not None
    least = min(19, os.getpriority(os.PRIO_PROCESS, own) + writer.NICENESS)
    until(lambda: os.getpriority(os.PRIO_PROCESS, writes) == least)


@pytest.mark.usefixtures("rare_renewals")
def test_session_written_since_the_last_renewal_is_not_renewed(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    saving.save(A, a_record(1))
    until(lambda: heard.said)
    saving._renew()
    assert store.renewed == []
    saving._renew()
    assert store.renewed == [A]


@pytest.mark.usefixtures("rare_renewals")
def test_failing_store_is_reported_once_and_again_when_it_recovers(
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
    del store.records["b"]  # it was away because it was restarted
    store.fails = False
    until(lambda: not saving.is_failing and saving.lag_s == 0.0 and ("gone", B) in heard.said)
    assert heard.said.count("failed") == 1
    assert ("renewed", A) in heard.said
    assert read_record(store.records["a"][1]).taken_seq == 2, "the waiting record was written"


def test_record_written_too_late_is_reported_after_a_failure_and_recovery(
    store: Store, heard: Heard, saving: SnapshotWriter, monkeypatch: pytest.MonkeyPatch
) -> None:
    saving.save(A, a_record(3))
    until(lambda: heard.said)
    monkeypatch.setattr(writer, "MAX_LAG_S", -1.0)
    saving.save(A, a_record(5))
    until(lambda: "failed" in heard.said)
    until(lambda: Written(A, 5) in heard.said)
    assert heard.said == [Written(A, 3), "failed", ("renewed", A), Written(A, 5)]


def test_fenced_session_is_reported_at_its_next_write_or_renewal(
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


def test_session_too_large_to_save_is_reported_lost_and_logged_once(
    heard: Heard, saving: SnapshotWriter, caplog: pytest.LogCaptureFixture
) -> None:
    for number in range(1, 4):
        saving.save(A, a_record(number, num_frames=MAX_BYTES // 48 + 1))
        until(lambda: saving.lag_s == 0 and ("lost", A) in heard.said)
    saving.save(B, a_record(1, num_frames=MAX_BYTES // 48 + 1))
    until(lambda: ("lost", B) in heard.said)
    said = [record.levelname for record in caplog.records if "is not saved" in record.getMessage()]
    assert said == ["WARNING", "WARNING"], "once for each session, since clients can cause it"


def test_drop_is_repeated_once_a_failing_store_recovers(store: Store, heard: Heard, saving: SnapshotWriter) -> None:
    store.fails = True
    saving.drop(A)
    until(lambda: "failed" in heard.said)
    assert not store.dropped
    store.fails = False
    until(lambda: store.dropped)
    assert store.dropped == [A]


class Dropping(Store):
    """Notes how many records each call drops; the first call that drops several fails."""

    def __init__(self) -> None:
        super().__init__()
        self.calls: list[int] = []

    def drop(self, leases: Sequence[Lease]) -> None:
        if len(self.calls) == 1:
            self.calls.append(0)
            raise StoreFailed("busy")
        super().drop(leases)
        self.calls.append(len(leases))


def test_sessions_that_end_together_are_dropped_by_several_calls(heard: Heard) -> None:
    """Otherwise other servers could not write to a file meanwhile. What a failure has left is dropped later."""
    store = Dropping()
    saving = SnapshotWriter(store, heard)
    store.gate.clear()
    saving.save(A, a_record(1))
    until(lambda: store.num_saves)
    leases = [Lease(f"{number}", 1) for number in range(2 * MOST_AT_ONCE + 1)]
    for lease in leases:
        saving.drop(lease)
    store.gate.set()
    until(lambda: len(store.dropped) == len(leases))
    assert store.dropped == leases
    assert store.calls == [MOST_AT_ONCE, 0, MOST_AT_ONCE, 1]
    saving.close()


def test_close_writes_waiting_records_unless_the_store_fails(store: Store, heard: Heard) -> None:
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


def test_adopted_session_is_renewed_and_fenced_without_being_saved(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    store.records["a"] = 1, b"as another server had saved it"
    saving.hold(A)
    until(lambda: A in store.renewed)
    assert heard.said == [], "this is nothing new for its client"
    store.others = {"a": 2}
    until(lambda: heard.said)
    assert heard.said == [("fenced", A)]
    del store.renewed[:]
    saving.hold(B)
    until(lambda: store.renewed.count(B) == 2)
    assert A not in store.renewed, "another server holds it"
