"""Sessions of another server that cannot be continued here: they stay where they are."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from motiongen_server.errors import EventRefused
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.taking_over import claimed
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Renewal
from motiongen_server.text.turns import Asker
from tests.server.engine.fakes import FACTS
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN, of_model, resuming


@pytest.mark.parametrize(
    ("point", "reason"),
    [
        ({"answered_seq": RECORD.taken_seq + 1}, "EVENTS_NOT_SAVED"),
        ({"plan": RECORD.snapshot.plan + 1}, "SNAPSHOT_UNUSABLE"),
        ({"next_frame": RECORD.snapshot.first_frame - 1}, "SNAPSHOT_UNUSABLE"),
        ({"next_frame": RECORD.snapshot.end_frame + 1}, "SNAPSHOT_UNUSABLE"),
    ],
)
async def test_session_is_not_taken_over_if_its_record_does_not_fit_the_client(
    durability: Durability, store: SqliteStore, point: dict[str, int], reason: str
) -> None:
    peer = Peer(PeerLimits(), 0.0, "studio")
    with pytest.raises(EventRefused) as refused:
        await claimed(durability, resuming(9, **point), peer, of_model("fake"), Asker())
    assert refused.value.reason == reason
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT]


@pytest.mark.parametrize(
    "others",
    [
        {"fps": 30},
        {"rig": replace(FACTS.rig, rig_id="another")},
        {"embedding_dim": 3},
        {"min_steps": 5},
        {"max_steps": 3},
        {"horizon": 48},
    ],
    ids=lambda others: "".join(others),
)
async def test_session_is_not_taken_over_for_another_model_of_the_same_name(
    durability: Durability, store: SqliteStore, others: dict[str, Any]
) -> None:
    """Servers are upgraded one by one, and a folder keeps its name when its model is replaced."""
    peer = Peer(PeerLimits(), 0.0, "studio")
    with pytest.raises(EventRefused, match="cannot be continued from its snapshot") as refused:
        await claimed(durability, resuming(9), peer, of_model("fake", **others), Asker())
    assert refused.value.reason == "SNAPSHOT_UNUSABLE"
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT]
