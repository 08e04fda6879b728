"""SnapshotTaker: asks the store for sessions of other servers whose clients resume them here."""

from __future__ import annotations

import logging
import secrets
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import TypeVar

from motiongen_server.snapshots.store import Held, Lease, SnapshotStore, StoreFailed

_log = logging.getLogger(__name__)

T = TypeVar("T")

TAKERS = 4
"""The number of threads, and so of sessions that are asked for at once."""


class SnapshotTaker:
    """Used from any thread. Clients wait for the answers, so nothing here waits for the writer."""

    def __init__(self, store: SnapshotStore) -> None:
        self._store = store
        self._holder = secrets.token_hex(4)
        self._threads = ThreadPoolExecutor(TAKERS, "snapshot-take")

    def read(self, name: str) -> Future[Held | None]:
        """The record of a session, whoever holds it. The future's exception is StoreFailed."""
        return self._threads.submit(self._asked, partial(self._store.read, name))

    def take(self, lease: Lease) -> Future[Held | None]:
        """Take a session over if that lease still holds it. The future's exception is StoreFailed."""
        return self._threads.submit(self._asked, partial(self._store.take, lease, self._holder))

    def _asked(self, call: Callable[[], T]) -> T:
        """Call the store. Whatever goes wrong, the caller gets StoreFailed."""
        try:
            return call()
        except StoreFailed:
            raise
        except Exception as error:
            _log.exception("%s failed unexpectedly", self._store)
            raise StoreFailed(f"{self._store}: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """Cancel calls that have not begun. The store stays open."""
        self._threads.shutdown(wait=False, cancel_futures=True)
