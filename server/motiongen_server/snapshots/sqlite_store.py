"""SqliteStore: snapshots in a file on this machine, for the servers that share it."""

from __future__ import annotations

import sqlite3
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TypeVar

from motiongen_server.snapshots.store import Held, Lease, Renewal, StoreFailed

BUSY_S = 0.5
"""How long a call waits for another process that writes."""
OPEN_S = 10.0
"""How long opening the file waits for that. A server that gave up sooner would not start, or save nothing ever."""
INCREMENTAL = 2
"""SQLite's number for files that can be shortened bit by bit."""
_SCHEMA = """
    CREATE TABLE IF NOT EXISTS sessions (
        name TEXT PRIMARY KEY, epoch INTEGER NOT NULL, holder TEXT NOT NULL, expires_at REAL NOT NULL, data BLOB
    )
"""
PAGE_BYTES = 16384
"""For new files. A record takes three of these pages, but ten of SQLite's default 4 KiB, and each page costs a call to
read, a call to write and a checksum. Existing files keep their page size.
"""
_INDEX = "CREATE INDEX IF NOT EXISTS sessions_by_expiry ON sessions (expires_at)"
"""Without it, each renewal would read a page of every record, while no other process can write."""
_CHECK = "SELECT name, epoch, holder, expires_at, data FROM sessions LIMIT 0"
_SAVE = """
    INSERT INTO sessions VALUES (?, ?, '', ?, ?) ON CONFLICT (name) DO UPDATE
    SET epoch = excluded.epoch, expires_at = excluded.expires_at, data = excluded.data
    WHERE sessions.epoch <= excluded.epoch
"""
_RENEW = "UPDATE sessions SET expires_at = ? WHERE name = ? AND epoch = ?"
_EPOCH = "SELECT epoch FROM sessions WHERE name = ?"
_TAKE = """
    UPDATE sessions SET epoch = epoch + 1, holder = ?, expires_at = ? WHERE name = ? AND epoch = ? AND expires_at > ?
    RETURNING epoch, data
"""
_READ = "SELECT epoch, data FROM sessions WHERE name = ? AND expires_at > ?"
_DROP = "DELETE FROM sessions WHERE name = ? AND epoch = ?"
MOST_EXPIRED = 64
"""Records that a renewal deletes. Thousands expire at once if a server was killed, and others could not write."""
_EXPIRE = f"""
    DELETE FROM sessions WHERE name IN (SELECT name FROM sessions WHERE expires_at <= ? LIMIT {MOST_EXPIRED})
"""
_SHRINK = "PRAGMA incremental_vacuum(1)"
MOST_SHRUNK_PAGES = 64
"""By which a renewal shortens a file that is mostly free."""
LEAST_FREE_PAGES = 1024
"""16 MiB, which a file keeps for new records."""

LOG_BYTES = 4 << 20
"""The size of the write-ahead log at which it is moved into the file."""
MOST_LOG_BYTES = 4 * LOG_BYTES
"""A log that has grown beyond this, in a large transaction or while others read, is shortened when it is reused."""

Result = TypeVar("Result")


class SqliteStore:
    """Has one connection per thread. Times in the file are wall-clock times, since other processes read them too."""

    def __init__(self, path: Path, keep_s: float, clock: Callable[[], float] = time.time) -> None:
        """keep_s: how long a record stays without being renewed. Raises StoreFailed if the file cannot be used, after
        OPEN_S at most.
        """
        self._path = path
        self._keep_s = keep_s
        self._clock = clock
        self._local = threading.local()
        self._lock = threading.Lock()
        self._at_rest: set[sqlite3.Connection] = set()  # connections not in use at present
        self._is_closed = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(mode=0o600)  # records hold users' prompts, which are private
        except OSError as error:
            raise StoreFailed(f"cannot keep snapshots in {path}: {error}") from error
        # Another program's file may have a different table of that name: better to fail now than at the first session.
        self._do(lambda connection: [connection.execute(each) for each in (_SCHEMA, _CHECK, _INDEX)], OPEN_S)

    def __str__(self) -> str:
        return f"sqlite:{self._path}"

    def save(self, records: Sequence[tuple[Lease, bytes]]) -> list[bool]:
        """As in SnapshotStore: all in one transaction."""
        expires_at = self._clock() + self._keep_s
        return self._do(
            lambda connection: [
                connection.execute(_SAVE, (*lease, expires_at, data)).rowcount > 0 for lease, data in records
            ]
        )

    def read(self, name: str) -> Held | None:
        """As in SnapshotStore."""
        row = self._do(lambda connection: connection.execute(_READ, (name, self._clock())).fetchone())
        return None if row is None else Held(*row)

    def take(self, lease: Lease, holder: str) -> Held | None:
        """As in SnapshotStore."""
        now = self._clock()
        asked = holder, now + self._keep_s, *lease, now
        row = self._do(lambda connection: connection.execute(_TAKE, asked).fetchone())
        return None if row is None else Held(*row)

    def renew(self, leases: Sequence[Lease]) -> list[Renewal]:
        """As in SnapshotStore; also deletes expired records, and shortens a file that is mostly free."""
        now = self._clock()

        def renew(connection: sqlite3.Connection) -> list[Renewal]:
            connection.executemany(_RENEW, [(now + self._keep_s, *lease) for lease in leases])
            connection.execute(_EXPIRE, (now,))
            _shrink(connection)
            held = [connection.execute(_EPOCH, (lease.name,)).fetchone() for lease in leases]
            return [_renewal(row, lease) for row, lease in zip(held, leases, strict=True)]

        return self._do(renew)

    def drop(self, leases: Sequence[Lease]) -> None:
        """As in SnapshotStore."""
        self._do(lambda connection: connection.executemany(_DROP, leases))

    def close(self) -> None:
        """As in SnapshotStore. Does not wait for calls in other threads, which end as usual."""
        with self._lock:
            self._is_closed = True
            while self._at_rest:  # closing a connection that is in use would crash the process
                self._at_rest.pop().close()

    def _do(self, work: Callable[[sqlite3.Connection], Result], busy_s: float = BUSY_S) -> Result:
        """Do the work in one write transaction. busy_s: how long to wait for its turn. Raises StoreFailed."""
        try:
            with self._used(self.connection()) as connection:
                with closing(connection.cursor()) as cursor:
                    cursor.execute(f"PRAGMA busy_timeout = {round(1000 * busy_s)}")
                    cursor.execute("BEGIN IMMEDIATE")
                with connection:
                    return work(connection)
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from error

    @contextmanager
    def _used(self, connection: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
        """Mark a connection as in use; close it afterwards if the store has been closed. Raises StoreFailed."""
        with self._lock:
            self._at_rest.discard(connection)
            is_closed = self._is_closed
        try:
            if is_closed:
                raise StoreFailed(f"{self._path} has been closed")
            yield connection
        finally:
            with self._lock:
                if self._is_closed:
                    connection.close()
                else:
                    self._at_rest.add(connection)

    def connection(self) -> sqlite3.Connection:
        """This thread's connection, opened at the first call."""
        connection: sqlite3.Connection | None = getattr(self._local, "connection", None)
        if connection is None:
            connection = sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
            connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            if connection.execute("PRAGMA auto_vacuum").fetchone() != (INCREMENTAL,):
                connection.execute(f"PRAGMA auto_vacuum = {INCREMENTAL}")  # has no effect on existing files
            connection.execute(f"PRAGMA wal_autocheckpoint = {LOG_BYTES // PAGE_BYTES}")
            connection.execute(f"PRAGMA journal_size_limit = {MOST_LOG_BYTES}")
            # The file survives the end of the process; only a crash of the machine may lose the last transactions.
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            self._local.connection = connection
        return connection


def _shrink(connection: sqlite3.Connection) -> None:
    """Give pages back that sessions no longer need. Does nothing in files of earlier versions, which cannot shrink."""
    (num_pages,), (num_free,) = (
        connection.execute(f"PRAGMA {of}").fetchone() for of in ("page_count", "freelist_count")
    )
    for _ in range(min(MOST_SHRUNK_PAGES, num_free - max(num_pages // 2, LEAST_FREE_PAGES))):
        connection.execute(_SHRINK)  # Python ends this statement after one page, however many it is asked for


def _renewal(row: tuple[int] | None, lease: Lease) -> Renewal:
    if row is None:
        return Renewal.GONE
    return Renewal.KEPT if row[0] <= lease.epoch else Renewal.FENCED
