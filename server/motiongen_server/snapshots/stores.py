"""Which store the settings ask for."""

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


def open_snapshot_store(asked: str, keep_s: float, folder: Path) -> SnapshotStore | None:
    """The store of a setting; None where none is asked for. Nothing is asked of a Redis yet. Raises SettingError.

    folder: of what outlives the server, for a file that is not named. `auto` is a file there; where there can be none,
    as on a read-only root, the log says so and sessions end with the server.
    """
    if asked in ("", NONE):
        return None
    try:
        if asked == AUTO:
            return _of_this_machine(folder / FILE, keep_s)
        if asked.startswith(SQLITE):
            name = asked.removeprefix(SQLITE)
            return SqliteStore(Path(name) if name else folder / FILE, keep_s)
        if asked.startswith(REDIS):
            return RedisStore(asked, keep_s)
    except (StoreFailed, ValueError) as error:
        raise SettingError(f"snapshot_store cannot be used: {error}") from error
    kind, colon, _ = asked.partition(":")  # what follows may hold a password
    shown = f"begins with {kind + colon!r}" if colon else f"is {asked!r}"
    raise SettingError(f"snapshot_store {shown}; it must be one of: {ALLOWED}")


def is_for_several_servers(asked: str) -> bool:
    """Whether a store is one that several servers use, each of which can go on with what the others have saved."""
    return asked.startswith(REDIS)


def _of_this_machine(path: Path, keep_s: float) -> SqliteStore | None:
    try:
        return SqliteStore(path, keep_s)
    except StoreFailed as error:
        _log.warning("sessions end with this server: %s; give --state-dir, or --snapshot-store none", error)
        return None


def state_folder(asked: str, environment: Mapping[str, str] | None = None) -> Path:
    """Where to keep what outlives the server. "": where this user's programs do (XDG base directories, STATE_HOME)."""
    if asked:
        return Path(asked)
    given = os.environ if environment is None else environment
    if home := given.get("XDG_STATE_HOME"):
        return Path(home) / "motiongen"
    try:
        return Path("~/.local/state/motiongen").expanduser()
    except RuntimeError:  # a user without a home, as containers have
        return Path("/var/lib/motiongen")
