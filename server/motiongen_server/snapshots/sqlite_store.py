"""SqliteStore: snapshots in a file of this machine, for servers that share it."""

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
_SCHEMA = """
    CREATE TABLE IF NOT EXISTS sessions (
        name TEXT PRIMARY KEY, epoch INTEGER NOT NULL, holder TEXT NOT NULL, expires_at REAL NOT NULL, data BLOB
    )
"""
PAGE_BYTES = 16384
"""Of a file that is made here. A record takes three of these pages where it takes ten of SQLite's own 4 KiB, and each
costs a call to read, one to write and a checksum. A file that there is already keeps its own.
"""
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
_EXPIRE = "DELETE FROM sessions WHERE expires_at <= ?"

LOG_BYTES = 4 << 20
"""Of the write-ahead log before it goes into the file."""

Result = TypeVar("Result")


class SqliteStore:
    """A connection of its own for each thread. Times in the file are the machine's, which others read too."""

    def __init__(self, path: Path, keep_s: float, clock: Callable[[], float] = time.time) -> None:
        """keep_s: how long a record stays that nobody renews. Raises StoreFailed where there can be no such file."""
        self._path = path
        self._keep_s = keep_s
        self._clock = clock
        self._local = threading.local()
        self._lock = threading.Lock()
        self._at_rest: set[sqlite3.Connection] = set()  # those that no thread is within
        self._is_closed = False
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch(mode=0o600)  # what people asked their characters to do is nobody else's business
        except OSError as error:
            raise StoreFailed(f"cannot keep snapshots in {path}: {error}") from error
        # Another program may have a table of that name: better refused now than with the first session.
        self._do(lambda connection: (connection.execute(_SCHEMA), connection.execute(_CHECK)))

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
        """As in SnapshotStore; what has expired is thrown away."""
        now = self._clock()

        def renew(connection: sqlite3.Connection) -> list[Renewal]:
            connection.executemany(_RENEW, [(now + self._keep_s, *lease) for lease in leases])
            connection.execute(_EXPIRE, (now,))
            held = [connection.execute(_EPOCH, (lease.name,)).fetchone() for lease in leases]
            return [_renewal(row, lease) for row, lease in zip(held, leases, strict=True)]

        return self._do(renew)

    def drop(self, leases: Sequence[Lease]) -> None:
        """As in SnapshotStore."""
        self._do(lambda connection: connection.executemany(_DROP, leases))

    def close(self) -> None:
        """As in SnapshotStore. A call that is at work in another thread is not waited for: it ends as it would."""
        with self._lock:
            self._is_closed = True
            while self._at_rest:  # to close one that a thread is within crashes the process
                self._at_rest.pop().close()

    def _do(self, work: Callable[[sqlite3.Connection], Result]) -> Result:
        """Do the work as one transaction that writes. Raises StoreFailed."""
        try:
            with self._used(self.connection()) as connection:
                with closing(connection.cursor()) as cursor:
                    cursor.execute("BEGIN IMMEDIATE")
                with connection:
                    return work(connection)
        except sqlite3.Error as error:
            raise StoreFailed(f"{self._path}: {error}") from error

    @contextmanager
    def _used(self, connection: sqlite3.Connection) -> Iterator[sqlite3.Connection]:
        """Keep a connection open meanwhile; close it then where the store has been closed. Raises StoreFailed."""
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
        """This thread's, opened when it is first asked for."""
        connection: sqlite3.Connection | None = getattr(self._local, "connection", None)
        if connection is None:
            connection = sqlite3.connect(self._path, timeout=BUSY_S, isolation_level=None, check_same_thread=False)
            connection.execute(f"PRAGMA page_size = {PAGE_BYTES}")
            connection.execute(f"PRAGMA wal_autocheckpoint = {LOG_BYTES // PAGE_BYTES}")
            # The file outlives the process as it is; only the machine's own end may take the last transactions.
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")
            self._local.connection = connection
        return connection


def _renewal(row: tuple[int] | None, lease: Lease) -> Renewal:
    if row is None:
        return Renewal.GONE
    return Renewal.KEPT if row[0] <= lease.epoch else Renewal.FENCED
