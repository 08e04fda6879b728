"""The store in a file of this machine, and which store the settings ask for."""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from motiongen_server.settings import SettingError
from motiongen_server.snapshots.sqlite_store import PAGE_BYTES, SqliteStore
from motiongen_server.snapshots.store import Lease, Renewal, StoreFailed
from motiongen_server.snapshots.stores import is_for_several_servers, open_snapshot_store, state_folder
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
        before.commit()
    store = SqliteStore(tmp_path / "a.sqlite", KEEP_S)
    assert store.save([(Lease("b", 1), b"y")]) == [True]
    assert store.take(Lease("a", 1), "other") == (2, b"x")
    assert store.take(Lease("b", 1), "other") == (2, b"y")
    store.close()


def test_new_file_has_the_page_size_for_records(tmp_path: Path) -> None:
    SqliteStore(tmp_path / "a.sqlite", KEEP_S).close()
    with closing(sqlite3.connect(tmp_path / "a.sqlite")) as made:
        assert made.execute("PRAGMA page_size").fetchone() == (PAGE_BYTES,)


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


@pytest.mark.parametrize(
    "asked",
    [
        "file.sqlite",
        "sqlite::memory:",
        "http://localhost",
        "redis://localhost:port",
        "redis://localhost/0?timeout=3",
        "redis://localhost/0?ssl_cert_reqs=none",
        "redis://localhost/0?decode_responses=true",
        "rediss://localhost/0?ssl_cert_reqs=bogus",
    ],
)
def test_unknown_store_is_a_setting_error(asked: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store"):
        open_snapshot_store(asked, KEEP_S, tmp_path)


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        ("redi://user:secret@localhost:7000/2", "...@localhost:7000/2"),
        ("unx:///run/redis.sock?password=secret", "unx:///run/redis.sock"),
        ("redis://:secret#of-mine@localhost:7000/2", "# as %23"),
    ],
)
def test_refusal_of_a_misspelled_address_names_it_without_password(asked: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store") as refused:
        open_snapshot_store(asked, KEEP_S, tmp_path)
    assert told in str(refused.value)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize(
    "asked",
    [
        "valkey://user:hush@localhost:6379/0",
        "redis://user:hush/hush@localhost:6379/0",
        "redis://user:hush#hush@localhost",
        "redis://user:hush?hush@localhost",
        "redis://user:12/hush@localhost",
        "redis://user:hush[hush@localhost",
        "rediss://user:hush@localhost/0?ssl_cert_reqs=bogus",
    ],
)
def test_refusal_of_a_store_does_not_reveal_its_password(asked: str, tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="snapshot_store") as refused:
        open_snapshot_store(asked, KEEP_S, tmp_path)
    assert "hush" not in str(refused.value)


def test_store_is_the_one_that_the_setting_names(tmp_path: Path) -> None:
    assert open_snapshot_store("none", KEEP_S, tmp_path) is None
    for asked in ("auto", "sqlite:"):
        assert (
            str(open_snapshot_store(asked, KEEP_S, tmp_path / "state")) == f"sqlite:{tmp_path}/state/snapshots.sqlite"
        )
    named = open_snapshot_store(f"sqlite:{tmp_path}/named", KEEP_S, tmp_path)
    assert str(named) == f"sqlite:{tmp_path}/named"
    redis = open_snapshot_store("redis://:secret@localhost:7000/2", KEEP_S, tmp_path)
    assert str(redis) == "redis://localhost:7000/2"
    for url, name in (
        ("unix:///run/redis.sock?db=1", "unix:///run/redis.sock"),
        ("redis://[::1]", "redis://[::1]:6379"),
    ):
        assert str(open_snapshot_store(url, KEEP_S, tmp_path)) == name
    for options in ("redis://localhost/0?max_connections=1", "rediss://localhost/0?ssl_cert_reqs=none"):
        assert open_snapshot_store(options, KEEP_S, tmp_path) is not None


def test_unwritable_folder_is_an_error_only_if_a_file_was_asked_for(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "state").write_text("a file where the folder should be")
    assert open_snapshot_store("auto", KEEP_S, tmp_path / "state") is None
    assert "sessions end with this server" in caplog.text
    with pytest.raises(SettingError, match="cannot be used"):
        open_snapshot_store("sqlite:", KEEP_S, tmp_path / "state")


@pytest.mark.parametrize(
    ("asked", "is_shared"),
    [
        ("auto", False),
        ("none", False),
        ("sqlite:x", False),
        ("redis://a", True),
        ("rediss://a", True),
        ("unix:///a", True),
    ],
)
def test_only_redis_stores_are_for_several_servers(asked: str, is_shared: bool) -> None:
    assert is_for_several_servers(asked) is is_shared


@pytest.mark.parametrize(
    ("asked", "environment", "folder"),
    [
        ("/var/lib/motion", {"XDG_STATE_HOME": "/state"}, "/var/lib/motion"),
        ("", {"XDG_STATE_HOME": "/state"}, "/state/motiongen"),
        ("", {}, str(Path("~/.local/state/motiongen").expanduser())),
    ],
)
def test_state_folder_is_the_setting_or_the_user_s_default(
    asked: str, environment: dict[str, str], folder: str
) -> None:
    assert str(state_folder(asked, environment)) == folder
