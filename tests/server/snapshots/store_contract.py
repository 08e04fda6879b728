"""Tests for every snapshot store, with a fixture `stores`: two servers' connections to one store."""

from __future__ import annotations

import threading
from typing import TypeAlias

from motiongen_server.snapshots.store import Lease, Renewal, SnapshotStore

Two: TypeAlias = tuple[SnapshotStore, SnapshotStore]


class StoreContract:
    """Modules with subclasses provide the fixture."""

    def test_record_is_what_was_saved_last(self, stores: Two) -> None:
        one, other = stores
        assert one.save([(Lease("a", 1), b"\x00one"), (Lease("b", 1), b"two")]) == [True, True]
        assert one.save([(Lease("a", 1), b"three\xff")]) == [True]
        assert other.read("a") == (1, b"three\xff")
        assert one.renew([Lease("a", 1)]) == [Renewal.KEPT], "reading takes nothing over"
        assert other.take(Lease("a", 1), "other") == (2, b"three\xff")
        assert other.take(Lease("c", 1), "other") is other.read("c") is None
        assert one.save([]) == []

    def test_fenced_holder_can_neither_write_nor_renew_nor_drop(self, stores: Two) -> None:
        one, other = stores
        one.save([(Lease("a", 1), b"old"), (Lease("b", 1), b"mine")])
        held = other.take(Lease("a", 1), "other")
        assert held is not None
        assert one.save([(Lease("a", 1), b"stale"), (Lease("b", 1), b"mine still")]) == [False, True]
        assert one.renew([Lease("a", 1), Lease("b", 1), Lease("c", 1)]) == [Renewal.FENCED, Renewal.KEPT, Renewal.GONE]
        one.drop([Lease("a", 1)])
        assert other.save([(Lease("a", held.epoch), b"new")]) == [True]
        assert one.take(Lease("a", 2), "one") == (3, b"new")
        assert other.renew([Lease("a", 2)]) == [Renewal.FENCED]

    def test_dropped_record_is_gone(self, stores: Two) -> None:
        one, other = stores
        one.save([(Lease("a", 4), b"old")])
        one.drop([Lease("a", 4), Lease("never", 1)])
        assert other.take(Lease("a", 4), "other") is None

    def test_session_is_taken_only_with_the_epoch_of_its_holder(self, stores: Two) -> None:
        one, other = stores
        one.save([(Lease("a", 3), b"x")])
        for epoch in (1, 2, 4, 30, 77):
            assert other.take(Lease("a", epoch), "other") is None
        assert one.renew([Lease("a", 3)]) == [Renewal.KEPT], "it stays with its holder"
        assert other.take(Lease("a", 3), "other") == (4, b"x")
        assert one.take(Lease("a", 3), "one") is None, "it was taken already"
        assert one.read("a") == (4, b"x")

    def test_concurrent_takers_of_a_session_get_different_epochs(self, stores: Two) -> None:
        one, other = stores
        one.save([(Lease("a", 1), b"x")])
        epochs: list[int] = []

        def take(store: SnapshotStore) -> None:
            for _ in range(20):
                held = None
                while held is None:
                    found = store.read("a")
                    assert found is not None
                    held = store.take(Lease("a", found.epoch), "someone")
                epochs.append(held.epoch)

        threads = [threading.Thread(target=take, args=(store,)) for store in (one, other, one, other)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sorted(epochs) == list(range(2, 82))
