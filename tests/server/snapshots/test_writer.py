"""The way to the store: the newest record of each session, whatever the store does meanwhile."""

from __future__ import annotations

import os
import threading

import pytest

from motiongen_server.snapshots import writer
from motiongen_server.snapshots.listener import Written
from motiongen_server.snapshots.record import MAX_BYTES, read_record
from motiongen_server.snapshots.store import Lease
from motiongen_server.snapshots.writer import SnapshotWriter
from tests.server.snapshots.kept import Heard, Store
from tests.server.snapshots.records import a_record
from tests.waiting import until

A, B = Lease("a", 1), Lease("b", 1)


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
    assert heard.said == [Written(A, 1), Written(B, 49), Written(A, 49)]


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
    until(lambda: not saving.is_failing and saving.lag_s == 0.0 and ("gone", B) in heard.said)
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


def test_a_session_that_was_taken_over_is_renewed_and_fenced_though_nothing_is_saved_of_it(
    store: Store, heard: Heard, saving: SnapshotWriter
) -> None:
    store.records["a"] = 1, b"as another server had saved it"
    saving.hold(A)
    until(lambda: A in store.renewed)
    assert heard.said == [], "that is nothing new to its client"
    store.others = {"a": 2}
    until(lambda: heard.said)
    assert heard.said == [("fenced", A)]
    del store.renewed[:]
    saving.hold(B)
    until(lambda: store.renewed.count(B) == 2)
    assert A not in store.renewed, "it is another's"
