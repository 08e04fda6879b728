"""Sessions of other servers: who may take them over, what that costs, and what a refusal leaves unchanged."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import grpc.aio
import pytest

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from motiongen_server.engine.types import Guidance
from motiongen_server.errors import EventRefused
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import REFUSAL_COST
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.limits import Limits, PeerLimits
from motiongen_server.rpc.sessions import taking_over
from motiongen_server.rpc.sessions.durability import Durability, lease_of
from motiongen_server.rpc.sessions.entry import Carrier
from motiongen_server.rpc.sessions.kept_answers import MAX_KEPT_BYTES
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.sessions.taking_over import adopted, claimed
from motiongen_server.rpc.streams import take_overs as stream_take_overs
from motiongen_server.snapshots.sqlite_store import SqliteStore
from motiongen_server.snapshots.store import Held, Lease, Renewal
from motiongen_server.text.turns import Asker
from tests.contract.local import LocalServer
from tests.server.engine.fakes import FACTS
from tests.server.rpc.sessions.test_kept_answers import placed
from tests.server.rpc.streams.test_event_order import Engine, Line, Prompts
from tests.server.snapshots.records import KEY, a_record
from tests.waiting import LIMIT_S, until_true

TOKEN = "secret.1"
NOBODY = cast(Carrier, None)  # for sessions whose outputs no test looks at
RECORD = a_record()


def of_model(model_id: str, **others: Any) -> ModelRegistry:
    """A registry with one model. others: facts of it that differ from those of the record's model."""
    facts = replace(FACTS, model_id=model_id, **others)
    catalog = Catalog(facts, Limits(), Guidance(2.0, 2.0), "CC0-1.0", text_encoder="counted", history_frames=16)
    return ModelRegistry(LoadedModel("fake", Engine(), Prompts(), catalog))  # type: ignore[arg-type]


def resuming(attempt: int, **point: int) -> session_pb2.OpenSession:
    """A resume from the middle of the record's frames, unless `point` says otherwise."""
    where = session_pb2.ResumePoint(**{"next_frame": 60, "attempt": attempt, **point})
    return session_pb2.OpenSession(resume_token=TOKEN, resume_point=where)


@pytest.mark.parametrize(
    ("tenant", "attempt", "model_id", "reason"),
    [
        ("thief", 9, "fake", "SESSION_NOT_KEPT"),
        ("studio", RECORD.attempt, "fake", "RESUME_SUPERSEDED"),
        ("studio", 9, "another", "UNKNOWN_MODEL"),
    ],
)
async def test_refused_take_over_leaves_the_session_with_its_server(
    durability: Durability, store: SqliteStore, tenant: str, attempt: int, model_id: str, reason: str
) -> None:
    peer = Peer(PeerLimits(), 0.0, tenant)
    with pytest.raises(EventRefused) as refused:
        await claimed(durability, resuming(attempt), peer, of_model(model_id), Asker())
    assert refused.value.reason == reason
    assert store.renew([lease_of(TOKEN)]) == [Renewal.KEPT]


async def test_owner_takes_its_session_over_and_fences_the_other_server(
    durability: Durability, store: SqliteStore
) -> None:
    peer, opening = Peer(PeerLimits(), 0.0, "studio"), resuming(9, answered_seq=RECORD.taken_seq)
    token, record = await claimed(durability, opening, peer, of_model("fake"), Asker())
    assert (token, record.taken_seq) == ("secret.2", RECORD.taken_seq)
    assert store.renew([lease_of(TOKEN)]) == [Renewal.FENCED]


async def test_resumes_with_invented_tokens_do_not_fill_the_log(
    durability: Durability, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(taking_over._log, "_clock", lambda: now[0])
    monkeypatch.setattr(taking_over._log, "_quiet_until", 0.0)
    monkeypatch.setattr(taking_over._log, "_left_out", 0)
    caplog.set_level(logging.INFO, taking_over.__name__)
    opening, peer, models = resuming(9), Peer(PeerLimits(), 0.0, "studio"), of_model("fake")
    opening.resume_token = "made up"
    for _ in range(1000):
        now[0] += 0.02
        with pytest.raises(EventRefused):
            await claimed(durability, opening, peer, models, Asker())
    lines = [record.message for record in caplog.records]
    assert 2 <= len(lines) <= 3, "one line in ten seconds, and twenty seconds have passed"
    assert ["like it since the last one" in line for line in lines] == [False] + [True] * (len(lines) - 1)


def test_steps_of_an_adopted_session_count_against_its_tenant_s_quota() -> None:
    models = of_model("fake")
    needed_hz = models.default.steps_hz(RECORD.snapshot.spec.denoise_steps)
    peer = Peer(PeerLimits(steps_per_second=1.5 * needed_hz, share=3.0), 0.0, "studio", "tenant:studio")

    def take_over() -> float:
        entry, event = adopted(
            RECORD,
            TOKEN,
            resuming(9),
            KEY,
            models=models,
            peer=peer,
            carrier=NOBODY,
            events_per_second=50.0,
            now=0.0,
        )
        assert entry.place.peer is peer
        return event.spec.owner.weight

    assert take_over() == 3.0, "its tenant's present share"
    with pytest.raises(EventRefused) as refused:
        take_over()
    assert refused.value.reason == "STEPS_QUOTA"
    assert peer.num_sessions == 1


async def test_answers_kept_by_another_server_are_cut_to_the_limit() -> None:
    answers = tuple(replace(placed(number), session=KEY) for number in range(1, 6))
    entry, _ = adopted(
        replace(RECORD, answers=answers),
        TOKEN,
        resuming(9),
        KEY,
        models=of_model("fake"),
        peer=Peer(PeerLimits(), 0.0, "studio"),
        carrier=NOBODY,
        events_per_second=50.0,
        now=0.0,
    )
    assert len(entry.answers) == 5
    assert entry.held_bytes <= MAX_KEPT_BYTES


class SlowStore(SqliteStore):
    """A store that answers once its gate is open."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, 60.0)
        self.gate = threading.Event()

    def read(self, name: str) -> Held | None:
        self.gate.wait(LIMIT_S)
        return super().read(name)

    def take(self, lease: Lease, holder: str) -> Held | None:
        self.gate.wait(LIMIT_S)
        return super().take(lease, holder)


async def test_client_that_half_closes_while_the_store_is_asked_is_answered(tmp_path: Path) -> None:
    store = SlowStore(tmp_path / "store.sqlite")
    opening = session_pb2.SessionEvent(session=1, event_seq=1, open=resuming(1))
    request = service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(), events=[opening])
    heard: list[session_pb2.SessionUpdate] = []
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(snapshots=store) as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion(iter([request]))
        async for response in call:
            heard += response.updates
            if not response.ByteSize():  # the server has seen the client's half-close
                store.gate.set()
        assert await call.code() is grpc.StatusCode.OK
    assert [update.outcome.reason for update in heard] == ["SESSION_NOT_KEPT"]


FAR = motion_pb2.RootTrajectory(positions=[1.0] * 800)
"""3.2 kB."""


def path(event_seq: int) -> session_pb2.EditConstraints:
    return session_pb2.EditConstraints(
        upsert=[motion_pb2.Constraint(constraint_id=event_seq, frame=40, root_trajectory=FAR)]
    )


async def test_events_behind_a_take_over_are_bounded_and_processed_as_they_are_paid(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monotonic, leapt_s = time.monotonic, [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: monotonic() + leapt_s[0])  # the event loop's clock too
    store = SlowStore(tmp_path / "store.sqlite")
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    line = Line(kept=KeptSessions(30.0, durability=durability))
    stream, peer = line.stream, line.stream.peer
    peer.limits = PeerLimits(waiting_bytes=20_000)
    line.send(1, open=resuming(1))
    for event_seq in range(2, 12):
        line.send(event_seq, edit_constraints=path(event_seq))
    assert [seq for seq, _ in line.refusals()] == [8, 9, 10, 11], "there was no room for these"
    assert {reason for _, reason in line.refusals()} == {"TOO_MANY_PENDING_EVENTS"}
    assert stream.budget.charged == 5 * REFUSAL_COST, "the resume, and each refusal"
    assert 16_000 < peer.waiting_bytes == stream.num_waiting_bytes <= 20_000

    stream.budget.charge(1e6, time.monotonic())
    store.gate.set()
    await until_true(lambda: line.refusals()[4:] == [(1, "SESSION_NOT_KEPT")])
    for _ in range(50):
        await asyncio.sleep(0)
    line.send(12, edit_constraints=path(12))
    assert len(line.refusals()) == 6, (
        "nothing behind it is processed while the stream is in debt; for the last there was no room"
    )
    leapt_s[0] = 1e4
    await until_true(lambda: not peer.waiting_bytes)
    assert line.refusals()[6:] == [(event_seq, "SESSION_NOT_OPEN") for event_seq in range(2, 8)]
    assert stream.num_waiting_bytes == 0
    await asyncio.to_thread(durability.close)


async def test_resume_longer_than_a_peer_s_waiting_bytes_is_refused(tmp_path: Path) -> None:
    durability = Durability(SlowStore(tmp_path / "store.sqlite"), asyncio.get_running_loop(), lambda _: None)
    line = Line(kept=KeptSessions(30.0, durability=durability))
    line.stream.peer.limits = PeerLimits(waiting_bytes=20_000)
    opening = resuming(1)
    opening.request_id = "x" * 20_000
    line.send(1, open=opening)
    assert line.refusals() == [(1, "TOO_MANY_PENDING_EVENTS")]
    assert line.stream.peer.waiting_bytes == 0
    await asyncio.to_thread(durability.close)


def _waiting_line(tmp_path: Path) -> tuple[Line, SlowStore, Durability]:
    store = SlowStore(tmp_path / "store.sqlite")
    durability = Durability(store, asyncio.get_running_loop(), lambda _: None)
    return Line(kept=KeptSessions(30.0, durability=durability)), store, durability


async def test_second_resume_on_a_handle_waits_for_the_first(tmp_path: Path) -> None:
    line, store, durability = _waiting_line(tmp_path)
    line.send(1, open=resuming(1))
    line.send(1, open=resuming(2))
    for event_seq in (2, 3):
        line.send(event_seq, edit_constraints=path(event_seq))
    store.gate.set()
    await until_true(lambda: len(line.refusals()) == 4)
    assert line.refusals() == [(1, "SESSION_NOT_KEPT")] * 2 + [(2, "SESSION_NOT_OPEN"), (3, "SESSION_NOT_OPEN")]
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    assert line.stream.num_waiting_bytes == 0
    await asyncio.to_thread(durability.close)


async def test_events_behind_a_take_over_are_dropped_once_the_client_has_gone(tmp_path: Path) -> None:
    """A session opened then would belong to no stream."""
    line, store, durability = _waiting_line(tmp_path)
    line.send(1, open=resuming(1))
    line.send(1, open=session_pb2.OpenSession())
    line.stream.budget.charge(1e6, time.monotonic())
    store.gate.set()
    await until_true(lambda: bool(line.refusals()))
    line.stream.lose()
    await until_true(lambda: not line.stream.peer.waiting_bytes)
    assert line.engine.events == []
    assert line.stream.num_sessions == 0
    await asyncio.to_thread(durability.close)


async def test_fault_during_a_take_over_ends_its_stream(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise its client would wait for an answer for ever."""

    async def broken(*_: object) -> None:
        raise RuntimeError("a bug")

    monkeypatch.setattr(stream_take_overs, "claimed", broken)
    line, store, durability = _waiting_line(tmp_path)
    line.send(1, open=resuming(1))
    await until_true(lambda: line.stream.refusal is not None)
    assert line.stream.refusal is not None
    assert line.stream.refusal.reason == "INTERNAL"
    store.gate.set()
    await asyncio.to_thread(durability.close)
