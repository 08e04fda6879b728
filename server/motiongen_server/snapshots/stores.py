"""Opens the store that the settings ask for."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from pathlib import Path

from motiongen_server.settings import SettingError
from motiongen_server.snapshots.redis_store import RedisStore
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import SnapshotStore, StoreFailed

_log = logging.getLogger(__name__)

AUTO, NONE = "auto", "none"
SQLITE = "sqlite:"
REDIS = ("redis://", "rediss://", "unix://")
ALLOWED = f"{AUTO}, {NONE}, {SQLITE}FILE, {SQLITE} for a file in the state folder, or {'HOST, '.join(REDIS)}PATH"
FILE = "snapshots.sqlite"
MEMORY = ":memory:"
"""SQLite's name for a database in memory."""


def open_snapshot_store(asked: str, keep_s: float, folder: Path) -> SnapshotStore | None:
    """The store of a setting; None if it asks for none. A Redis is not connected to yet. Raises SettingError.

    folder: the state folder, for a file without a name. `auto` is a file there; if it cannot be made, as on a read-only
    root, the log says so, and sessions end with the server.
    """
    if asked in ("", NONE):
        return None
    try:
        if asked == AUTO:
            return _of_this_machine(folder / FILE, keep_s)
        if asked.startswith(SQLITE):
            name = asked.removeprefix(SQLITE)
            if name == MEMORY:  # each connection would have a database of its own
                raise ValueError(f"{MEMORY} is not a file, and would not outlive the server; give a file, or {NONE}")
            return SqliteStore(Path(name) if name else folder / FILE, keep_s)
        if asked.startswith(REDIS):
            return RedisStore(asked, keep_s)
    except (StoreFailed, ValueError) as error:
        raise SettingError(f"snapshot_store cannot be used: {error}") from error
    raise SettingError(f"snapshot_store is {_without_password(asked)!r}; it must be one of: {ALLOWED}")


def _without_password(asked: str) -> str:
    """The setting as it may appear in a log: of an address, even a misspelled one, only what follows the password."""
    told = asked.partition("?")[0]
    return f"...{told[told.rindex('@') :]}" if "@" in told else told


def is_for_several_servers(asked: str) -> bool:
    """Whether a store is for several servers, which can continue each other's sessions."""
    return asked.startswith(REDIS)


def _of_this_machine(path: Path, keep_s: float) -> SqliteStore | None:
    try:
        return SqliteStore(path, keep_s)
    except StoreFailed as error:
        _log.warning("sessions end with this server: %s; give --state-dir, or --snapshot-store none", error)
        return None


def state_folder(asked: str, environment: Mapping[str, str] | None = None) -> Path:
    """The folder for what outlives the server. "": the user's state folder (XDG base directories, STATE_HOME)."""
    if asked:
        return Path(asked)
    given = os.environ if environment is None else environment
    if home := given.get("XDG_STATE_HOME"):
        return Path(home) / "motiongen"
    try:
        return Path("~/.local/state/motiongen").expanduser()
    except RuntimeError:  # a user without a home, as in containers
        return Path("/var/lib/motiongen")
