"""Calls to the store on behalf of clients that resume."""

from __future__ import annotations

import pytest

from motiongen_server.snapshots.store import Held, Lease, StoreFailed
from motiongen_server.snapshots.taker import SnapshotTaker
from tests.server.snapshots.kept import Store
from tests.waiting import LIMIT_S


def test_take_returns_or_raises_what_the_store_does(store: Store) -> None:
    taker = SnapshotTaker(store)
    store.records["a"] = 1, b"record"
    assert taker.take(Lease("a", 1)).result() == Held(2, b"record")
    assert taker.take(Lease("c", 1)).result() is None
    store.fails = True
    with pytest.raises(StoreFailed):
        taker.take(Lease("a", 1)).result()
    taker.close()


def test_unexpected_error_of_the_store_is_raised_as_store_failed(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def break_down() -> None:
        raise TypeError("an option that there is not")

    monkeypatch.setattr(store, "_check", break_down)
    taker = SnapshotTaker(store)
    for asked in (taker.read("a"), taker.take(Lease("a", 1))):
        with pytest.raises(StoreFailed, match="TypeError"):
            asked.result(LIMIT_S)
    taker.close()
