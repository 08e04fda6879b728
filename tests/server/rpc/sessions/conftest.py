"""A store with a session of another server, and the edge's access to it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.snapshots.record import write_record
from motiongen_server.snapshots.sqlite_store import SqliteStore
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN


@pytest.fixture
def store(tmp_path: Path) -> SqliteStore:
    """A store with a session of another server."""
    store = SqliteStore(tmp_path / "store.sqlite", 60.0)
    store.save([(lease_of(TOKEN), write_record(RECORD))])
    return store


@pytest.fixture
async def durability(store: SqliteStore) -> AsyncIterator[Durability]:
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    yield durability
    await asyncio.to_thread(durability.close)
