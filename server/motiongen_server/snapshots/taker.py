"""SnapshotTaker: what the store is asked for whoever resumes a session that another server had."""

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
"""Threads that ask: so many sessions are asked for at once."""


class SnapshotTaker:
    """Used from any thread. Who asks waits, so nothing here waits for what is being written."""

    def __init__(self, store: SnapshotStore) -> None:
        self._store = store
        self._holder = secrets.token_hex(4)
        self._threads = ThreadPoolExecutor(TAKERS, "snapshot-take")

    def read(self, name: str) -> Future[Held | None]:
        """The record of a session, whoever holds it. Its exception is StoreFailed."""
        return self._threads.submit(self._asked, partial(self._store.read, name))

    def take(self, lease: Lease) -> Future[Held | None]:
        """Take a session over, if it is still held by that lease. Its exception is StoreFailed."""
        return self._threads.submit(self._asked, partial(self._store.take, lease, self._holder))

    def _asked(self, call: Callable[[], T]) -> T:
        """What a call of the store answers. Whatever goes wrong with it, who asked is told that the store failed."""
        try:
            return call()
        except StoreFailed:
            raise
        except Exception as error:
            _log.exception("%s failed as no store should", self._store)
            raise StoreFailed(f"{self._store}: {type(error).__name__}: {error}") from error

    def close(self) -> None:
        """What is not being asked yet is not asked any more. The store stays open."""
        self._threads.shutdown(wait=False, cancel_futures=True)
