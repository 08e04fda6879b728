"""Which store the settings ask for."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from motiongen_server.settings import SettingError
from motiongen_server.snapshots.redis_store import RedisStore
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import SnapshotStore, StoreFailed

SQLITE = "sqlite:"
REDIS = ("redis://", "rediss://", "unix://")
ALLOWED = f"none, {SQLITE}FILE, {SQLITE} for a file of this user, or {'HOST, '.join(REDIS)}PATH"


def open_snapshot_store(
    asked: str, keep_s: float, environment: Mapping[str, str] | None = None
) -> SnapshotStore | None:
    """The store of a setting; None where none is asked for. Nothing is asked of a Redis yet. Raises SettingError."""
    if asked in ("", "none"):
        return None
    try:
        if asked.startswith(SQLITE):
            name = asked.removeprefix(SQLITE)
            path = Path(name) if name else default_file(os.environ if environment is None else environment)
            return SqliteStore(path, keep_s)
        if asked.startswith(REDIS):
            return RedisStore(asked, keep_s)
    except (StoreFailed, ValueError) as error:
        raise SettingError(f"snapshot_store cannot be used: {error}") from error
    raise SettingError(f"snapshot_store is {asked!r}; it must be one of: {ALLOWED}")


def default_file(environment: Mapping[str, str]) -> Path:
    """Where this user's programs keep what outlives them (XDG base directories, STATE_HOME)."""
    home = environment.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(home) / "motiongen" / "snapshots.sqlite"
