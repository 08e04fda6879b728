"""The store in a file of this machine."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from motiongen_server.snapshots import sqlite_store
from motiongen_server.snapshots.sqlite_store import (
    LEAST_FREE_PAGES,
    MOST_EXPIRED,
    MOST_SHRUNK_PAGES,
    PAGE_BYTES,
    SqliteStore,
)
from motiongen_server.snapshots.store import Lease, Renewal, StoreFailed
from motiongen_server.snapshots.writer import SnapshotWriter
from tests.server.snapshots.kept import Heard
from tests.server.snapshots.store_contract import StoreContract, Two
from tests.waiting import LIMIT_S, until

KEEP_S = 60.0


@pytest.fixture
def stores(tmp_path: Path) -> Iterator[Two]:
    two = SqliteStore(tmp_path / "a" / "b.sqlite", KEEP_S), SqliteStore(tmp_path / "a" / "b.sqlite", KEEP_S)
    yield two
    for store in two:
        store.close()


class TestSqlite(StoreContract):
    """A file that two servers share."""


def test_records_that_are_not_renewed_expire(tmp_path: Path) -> None:
    now = [1000.0]
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S, lambda: now[0])
    store.save([(Lease("a", 1), b"x"), (Lease("b", 1), b"y")])
    now[0] += KEEP_S - 1
    assert store.renew([Lease("b", 1)]) == [Renewal.KEPT]
    now[0] += 2
    assert store.take(Lease("a", 1), "other") is None
    assert store.take(Lease("b", 1), "other") == (2, b"y")
    store.renew([])
    assert store.renew([Lease("a", 1)]) == [Renewal.GONE]


def test_expired_records_are_deleted_although_there_are_no_sessions(tmp_path: Path) -> None:
    """Records contain what people asked their characters to do."""
    now = [1000.0]
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S, lambda: now[0])
    store.save([(Lease("a", 1), b"x")])
    now[0] += KEEP_S + 1
    writer = SnapshotWriter(store, Heard())
    with closing(sqlite3.connect(tmp_path / "a.sqlite")) as looking:
        until(lambda: looking.execute("SELECT count(*) FROM sessions").fetchone() == (0,))
    writer.close()


def test_file_of_an_earlier_version_is_read_and_written(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "a.sqlite")) as before:
        before.execute(
            "CREATE TABLE sessions (name TEXT PRIMARY KEY, epoch INTEGER NOT NULL, holder TEXT NOT NULL, "
            "expires_at REAL NOT NULL, data BLOB) WITHOUT ROWID"
        )
        before.execute("INSERT INTO sessions VALUES ('a', 1, '', 1e12, x'78')")
        before.executemany(
            "INSERT INTO sessions VALUES (?, 1, '', 1e12, x'78')", [(f"{each}",) for each in range(1000)]
        )
        before.commit()
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S)
    assert store.save([(Lease("b", 1), b"y")]) == [True]
    assert store.take(Lease("a", 1), "other") == (2, b"x")
    assert store.take(Lease("b", 1), "other") == (2, b"y")
    assert store.renew([Lease("a", 2), Lease("b", 2)]) == [Renewal.KEPT, Renewal.KEPT]
    assert steps_of_a_renewal(store) < 500
    store.close()


def steps_of_a_renewal(store: SqliteStore) -> int:
    """How many of SQLite's own instructions it takes, where nothing is renewed and nothing has expired."""
    steps = [0]
    store.connection().set_progress_handler(lambda: steps.__setitem__(0, steps[0] + 1), 1)
    store.renew([])
    store.connection().set_progress_handler(None, 1)
    return steps[0]


def test_renewal_does_not_look_at_all_records(tmp_path: Path) -> None:
    """With thousands of records it would keep other servers from writing."""
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S)
    before = steps_of_a_renewal(store)
    store.save([(Lease(f"{number}", 1), b"x") for number in range(1000)])
    assert steps_of_a_renewal(store) < before + 100
    store.close()


def test_records_that_expire_together_are_deleted_by_several_renewals(tmp_path: Path) -> None:
    now = [1000.0]
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S, lambda: now[0])
    store.save([(Lease(f"{number}", 1), b"x") for number in range(2 * MOST_EXPIRED + 1)])
    now[0] += KEEP_S
    left = []
    for _ in range(3):
        store.renew([])
        left += store.connection().execute("SELECT count(*) FROM sessions").fetchone()
    assert left == [MOST_EXPIRED + 1, 1, 0]
    store.close()


def test_file_shrinks_bit_by_bit_once_most_of_it_is_free(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S)

    def num_pages() -> int:
        return sum(store.connection().execute("PRAGMA page_count").fetchone())

    record = bytes(PAGE_BYTES * (LEAST_FREE_PAGES + 10))
    leases = [Lease(name, 1) for name in "abc"]
    store.save([(lease, record) for lease in leases])
    store.drop(leases[:1])
    full = num_pages()
    store.renew([])
    assert num_pages() == full, "a third is free, which sessions to come will need"
    store.drop(leases[1:])
    store.renew([])
    assert num_pages() == full - MOST_SHRUNK_PAGES
    for _ in range(full // MOST_SHRUNK_PAGES):
        store.renew([])
    assert 0 <= num_pages() - LEAST_FREE_PAGES < 10
    store.close()
    assert (tmp_path / "a.sqlite").stat().st_size < (LEAST_FREE_PAGES + 10) * PAGE_BYTES


def test_new_file_has_the_page_size_for_records(tmp_path: Path) -> None:
    SqliteStore(tmp_path / "a.sqlite", KEEP_S).close()
    with closing(sqlite3.connect(tmp_path / "a.sqlite")) as made:
        assert made.execute("PRAGMA page_size").fetchone() == (PAGE_BYTES,)


class Beginning(SqliteStore):
    """Says when it is about to ask for its turn to write."""

    has_begun = threading.Event()

    def connection(self) -> sqlite3.Connection:
        connection = super().connection()
        connection.set_trace_callback(lambda statement: self.has_begun.set() if "BEGIN" in statement else None)
        return connection


def test_opening_waits_longer_for_another_process_than_calls_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a server would not start, or save nothing, since another was stopped for a moment while it wrote."""
    SqliteStore(tmp_path / "a.sqlite", KEEP_S).close()
    monkeypatch.setattr(sqlite_store, "BUSY_S", 0.0)
    with closing(sqlite3.connect(tmp_path / "a.sqlite", isolation_level=None)) as other, ThreadPoolExecutor(1) as pool:
        other.execute("BEGIN IMMEDIATE")
        opening = pool.submit(Beginning, tmp_path / "a.sqlite", KEEP_S)
        assert Beginning.has_begun.wait(LIMIT_S)
        other.execute("COMMIT")
        opening.result(LIMIT_S).close()


def test_a_file_of_sessions_is_for_its_owner_only(tmp_path: Path) -> None:
    SqliteStore(tmp_path / "a.sqlite", KEEP_S).close()
    assert (tmp_path / "a.sqlite").stat().st_mode & 0o077 == 0


def test_file_that_is_no_database_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "a.sqlite").write_bytes(b"this is no database at all, and it is long enough to be looked at" * 20)
    with pytest.raises(StoreFailed, match=r"a\.sqlite"):
        SqliteStore(tmp_path / "a.sqlite", KEEP_S)


def test_table_of_another_program_is_refused_and_left_alone(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "a.sqlite")) as other:
        other.execute("CREATE TABLE sessions (user TEXT, expires_at REAL)")
        other.execute("INSERT INTO sessions VALUES ('somebody', 1.0)")
        other.commit()
        with pytest.raises(StoreFailed, match=r"a\.sqlite: no such column"):
            SqliteStore(tmp_path / "a.sqlite", KEEP_S)
        assert other.execute("SELECT * FROM sessions").fetchall() == [("somebody", 1.0)]


def test_save_fails_on_a_full_disk_and_works_once_there_is_room(tmp_path: Path) -> None:
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S)
    store.save([(Lease("a", 1), b"old")])
    connection = store.connection()
    (pages,) = connection.execute("PRAGMA page_count").fetchone()
    connection.execute(f"PRAGMA max_page_count = {pages + 1}")
    with pytest.raises(StoreFailed, match="full"):
        store.save([(Lease("a", 1), bytes(100_000))])
    connection.execute("PRAGMA max_page_count = 100000")
    assert store.save([(Lease("a", 1), bytes(100_000))]) == [True]


class Held(Sequence[tuple[Lease, bytes]]):
    """Records whose reading begins and then waits until the test lets it continue."""

    def __init__(self, *records: tuple[Lease, bytes]) -> None:
        self._records = records
        self.is_begun, self.may_go_on = threading.Event(), threading.Event()

    def __len__(self) -> int:
        return len(self._records)

    def __getitem__(self, index: Any) -> Any:
        self.is_begun.set()
        assert self.may_go_on.wait(LIMIT_S)
        return self._records[index]


def test_call_in_progress_when_the_store_is_closed_is_completed(tmp_path: Path) -> None:
    """A server that ends waits only briefly for its last writes, and must not crash while one is still running."""
    store, records = SqliteStore(tmp_path / "a.sqlite", KEEP_S), Held((Lease("a", 1), b"x"))
    with ThreadPoolExecutor(1) as pool:
        saving = pool.submit(store.save, records)
        assert records.is_begun.wait(LIMIT_S)
        store.close()
        records.may_go_on.set()
        assert saving.result(LIMIT_S) == [True]
        for late in (pool.submit(store.read, "a"), pool.submit(store.save, [(Lease("a", 2), b"y")])):
            assert isinstance(late.exception(LIMIT_S), StoreFailed)
    assert SqliteStore(tmp_path / "a.sqlite", KEEP_S).read("a") == (1, b"x")
