"""Vectors stored in an SQLite file, kept across restarts and shared by the processes of one machine."""

from __future__ import annotations

import contextlib
import logging
import sqlite3
import threading
import time
from pathlib import Path

import numpy as np

from motiongen_ardy.text.encoder import Vectors

_log = logging.getLogger(__name__)

SCHEMA = 1
LOCK_WAIT_S = 2.0
PRUNE_TO = 0.9
COUNT_SHARE = 0.01
"""Vectors written between two counts, as a share of max_entries: SQLite reads the whole file to count."""
TOUCH_S = 3600.0
"""Resolution of the time of last use: recording every use would make every read a write."""
BROKEN = (sqlite3.Error, ValueError, TypeError)
"""Errors from a file that something else wrote to: SQLite does not enforce column types, but Python's numbers do."""
CREATE = (
    """
    CREATE TABLE IF NOT EXISTS vectors (
        encoder TEXT NOT NULL, text TEXT NOT NULL, vector BLOB NOT NULL, used_at REAL NOT NULL,
        PRIMARY KEY (encoder, text)
    ) WITHOUT ROWID
    """,
    "CREATE TABLE IF NOT EXISTS encoders (name TEXT PRIMARY KEY, identity TEXT NOT NULL, width INTEGER NOT NULL)",
)


def known_encoder(path: Path, name: str) -> tuple[str, int] | None:
    """Identity and width of the encoder called `name`, as last noted in the store in this file; None if not noted."""
    if not path.is_file():
        return None
    try:
        with contextlib.closing(sqlite3.connect(path, timeout=LOCK_WAIT_S)) as connection:
            row = connection.execute("SELECT identity, width FROM encoders WHERE name = ?", (name,)).fetchone()
        return None if row is None else (str(row[0]), int(row[1]))
    except BROKEN:
        return None


class VectorStore:
    """The vectors of one encoder's texts. The key is the encoder's identity, which names its precision, and the text.

    Thread-safe. The store only saves time, so it never raises: if the file is broken, locked or full, it warns once and
    stores nothing. A file that is not a database is renamed.
    """

    def __init__(self, path: Path, identity: str, width: int, max_entries: int = 65_536) -> None:
        """max_entries: of all encoders, exceeded by at most a hundredth; the least recently used are deleted."""
        self._identity = identity
        self._width = width
        self._max_entries = max_entries
        self._uncounted = 0
        self._path = path
        self._lock = threading.Lock()
        self._has_warned = False
        self._connection = self._open()

    def get(self, text: str) -> Vectors | None:
        """(width,) for the text; None if it is not stored."""
        with self._lock:
            try:
                return self._get(text)
            except BROKEN as error:
                self._warn(error)
                return None

    def put(self, text: str, vector: Vectors) -> None:
        """Store the vector of a text."""
        with self._lock:
            try:
                self._put(text, vector)
            except BROKEN as error:
                self._warn(error)

    def note_encoder(self, name: str) -> None:
        """Record that this store's encoder is the one called `name`, for `known_encoder`."""
        with self._lock:
            try:
                if self._connection is not None:
                    with self._connection:
                        self._connection.execute(
                            "INSERT OR REPLACE INTO encoders VALUES (?, ?, ?)", (name, self._identity, self._width)
                        )
            except BROKEN as error:
                self._warn(error)

    def close(self) -> None:
        """Close the file."""
        with self._lock:
            if self._connection is not None:
                self._connection.close()
                self._connection = None

    def _get(self, text: str) -> Vectors | None:
        if self._connection is None:
            return None
        key = (self._identity, text)
        query = "SELECT vector, used_at FROM vectors WHERE encoder = ? AND text = ?"
        row = self._connection.execute(query, key).fetchone()
        if row is None:
            return None
        content, used_at = row
        if not isinstance(content, bytes) or len(content) != 4 * self._width:
            return None
        vector = np.frombuffer(content, "<f4").astype(np.float32)
        if not np.isfinite(vector).all():
            return None
        if abs(time.time() - used_at) > TOUCH_S:
            with self._connection:
                self._connection.execute(
                    "UPDATE vectors SET used_at = ? WHERE encoder = ? AND text = ?", (time.time(), *key)
                )
        return vector

    def _put(self, text: str, vector: Vectors) -> None:
        if self._connection is None:
            return
        content = np.ascontiguousarray(vector, "<f4").tobytes()
        with self._connection:
            self._connection.execute(
                "INSERT OR REPLACE INTO vectors VALUES (?, ?, ?, ?)", (self._identity, text, content, time.time())
            )
            self._uncounted -= 1
            if self._uncounted <= 0:
                self._prune(self._connection)

    def _prune(self, connection: sqlite3.Connection) -> None:
        """Count, delete what is too much, and set when to count again: other processes may write to the file too."""
        (count,) = connection.execute("SELECT count(*) FROM vectors").fetchone()
        if count > self._max_entries:
            surplus = count - int(PRUNE_TO * self._max_entries)
            connection.execute(
                "DELETE FROM vectors WHERE (encoder, text) IN "
                "(SELECT encoder, text FROM vectors ORDER BY used_at LIMIT ?)",
                (surplus,),
            )
        self._uncounted = int(COUNT_SHARE * self._max_entries)

    def _open(self) -> sqlite3.Connection | None:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            return self._connect()
        except sqlite3.OperationalError as error:  # no permission, no space: not the file's fault
            self._warn(error)
        except sqlite3.DatabaseError as error:
            return self._start_anew(error)
        except OSError as error:
            self._warn(error)
        return None

    def _connect(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self._path, timeout=LOCK_WAIT_S, check_same_thread=False)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = NORMAL")  # a crash may lose the last writes, never the file
            (schema,) = connection.execute("PRAGMA user_version").fetchone()
            if schema not in (0, SCHEMA):
                raise sqlite3.OperationalError(f"it was written by another version, {schema}")
            with connection:
                for statement in CREATE:
                    connection.execute(statement)
                connection.execute(f"PRAGMA user_version = {SCHEMA}")
        except sqlite3.Error:
            connection.close()
            raise
        return connection

    def _start_anew(self, error: Exception) -> sqlite3.Connection | None:
        aside = self._path.with_name(self._path.name + ".broken")
        _log.warning("the prompt store %s is no database (%s); it is now %s", self._path, error, aside.name)
        try:
            self._path.replace(aside)
            return self._connect()
        except (OSError, sqlite3.Error) as second:
            self._warn(second)
            return None

    def _warn(self, error: Exception) -> None:
        if not self._has_warned:
            self._has_warned = True
            _log.warning("the prompt store %s cannot be used: %s", self._path, error)
