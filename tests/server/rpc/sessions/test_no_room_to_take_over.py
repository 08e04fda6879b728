"""Sessions of other servers that are requested where there is no room for them: they stay where they are."""

from __future__ import annotations

import pytest

from motiongen_server.replicas.hint import OtherServer
from motiongen_server.rpc.errors.events import model_failed
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Renewal
from tests.server.rpc.sessions.test_taking_over import RECORD, TOKEN, of_model, resuming
from tests.server.rpc.streams.test_event_order import Line
from tests.waiting import until_true


@pytest.mark.parametrize(
    ("limits", "most_steps", "reason"),
    [
        ({"session_weight": 0}, 1000, "PEER_SESSION_LIMIT"),
        ({"steps_per_second": 1.0}, 1000, "STEPS_QUOTA"),
        ({}, 0, "OVERLOADED"),
    ],
)
async def test_session_is_not_taken_over_by_a_server_without_room(
    store: SqliteStore, durability: Durability, limits: dict[str, float], most_steps: int, reason: str
) -> None:
    line = Line(catalog=of_model("fake").default.catalog, kept=KeptSessions(30.0, durability=durability))
    stream, line.engine.most_steps = line.stream, most_steps
    stream.peer.tenant, stream.peer.limits = RECORD.tenant, PeerLimits(**limits)  # type: ignore[arg-type]
    stream.other_servers = lambda model_id: (OtherServer(f"{model_id}.example", ""),)
    line.send(1, open=resuming(9))
    await until_true(lambda: bool(line.refusals()))
    assert line.refusals() == [(1, reason)]
    named = [each.address for each in line.updates()[0].outcome.other_servers]
    assert named == (["fake.example"] if reason == "OVERLOADED" else []), "another server is no way around a quota"
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT]
    assert (line.engine.events, stream.peer.num_sessions) == ([], 0)


async def test_session_of_a_failed_model_is_not_taken_over_and_others_are_named(
    store: SqliteStore, durability: Durability
) -> None:
    line = Line(catalog=of_model("fake").default.catalog, kept=KeptSessions(30.0, durability=durability))
    line.stream.peer.tenant = RECORD.tenant
    line.stream.other_servers = lambda model_id: (OtherServer(f"{model_id}.example", ""),)
    line.models.default.refusal = model_failed("fake", "its weights have changed")
    line.send(1, open=resuming(9))
    await until_true(lambda: bool(line.refusals()))
    assert line.refusals() == [(1, "MODEL_FAILED")]
    assert [each.address for each in line.updates()[0].outcome.other_servers] == ["fake.example"]
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT]
