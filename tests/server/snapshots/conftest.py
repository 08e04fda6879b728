"""A snapshot writer with short waits, its store, and the receiver of its reports."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from motiongen_server.snapshots import writer
from motiongen_server.snapshots.writer import SnapshotWriter
from tests.server.snapshots.kept import Heard, Store
from tests.waiting import LIMIT_S


@pytest.fixture(autouse=True)
def short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writer, "RETRY_S", 0.01)
    monkeypatch.setattr(writer, "RENEW_EVERY_S", 0.02)
    monkeypatch.setattr(writer, "MAX_LAG_S", LIMIT_S)  # a busy machine must not count as a slow store


@pytest.fixture
def rare_renewals(short_waits: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """No renewals: only a write can find that the store fails."""
    monkeypatch.setattr(writer, "RENEW_EVERY_S", LIMIT_S)


@pytest.fixture
def store() -> Store:
    return Store()


@pytest.fixture
def heard() -> Heard:
    return Heard()


@pytest.fixture
def saving(store: Store, heard: Heard) -> Iterator[SnapshotWriter]:
    saving = SnapshotWriter(store, heard)
    yield saving
    store.gate.set()
    saving.close()
