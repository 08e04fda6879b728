"""A stream's bookkeeping: events that wait for the encoder, refusals, unread output, and what each costs."""

from __future__ import annotations

import asyncio
import contextlib
import gc
import itertools
import time
from collections.abc import Sequence

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_server.engine.types import Chunk, Close, Closed, CloseReason, Code, Open, Outcome
from motiongen_server.engine.types.refusals import session_closed
from motiongen_server.replicas.hint import OtherServer
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.budgets.stream_budget import CONSTRAINT_COST, PATH_COST, REFUSAL_COST
from motiongen_server.rpc.limits import PeerLimits
from motiongen_server.rpc.sessions.event_path import MAX_WAITING_EVENTS
from motiongen_server.rpc.streams.stream import Stream
from motiongen_server.text.turns import Asker
from tests.server.rpc.streams.test_event_order import HANDLE, PAUSE, WALK, Line, make_catalog
from tests.waiting import until_true


@pytest.fixture
async def line() -> Line:
    return Line(make_catalog(events_per_second=1000.0))


def fault(line: Line) -> Closed:
    return Closed(line.engine.events[0].session, CloseReason.ENGINE_FAULT, Code.INTERNAL, "it failed", 0, 0)


async def test_waiting_events_are_answered_before_their_session_s_end_is_sent(line: Line) -> None:
    line.open()
    line.send(2, edit_prompts=WALK)
    line.send(3, set_play_state=PAUSE)
    line.stream.take(fault(line))
    assert line.refusals() == [(2, "SESSION_CLOSED"), (3, "SESSION_CLOSED")]
    assert line.updates()[-1].HasField("closed")
    assert line.updates()[-1].applied_seq == 3


async def test_events_of_an_ended_session_do_not_reach_the_next_on_its_handle(line: Line) -> None:
    line.open()
    line.send(2, edit_prompts=WALK)
    line.stream.take(fault(line))
    line.send(1, open=session_pb2.OpenSession(request_id="second", prompts=WALK.upsert))
    await line.encoded()
    assert line.engine.kinds() == [Open, Open]


async def test_invalid_open_is_refused_before_its_prompts_are_encoded(line: Line) -> None:
    line.send(1, open=session_pb2.OpenSession(rig_id="none", prompts=WALK.upsert))
    line.send(2, edit_prompts=WALK)
    assert line.refusals() == [(1, "UNKNOWN_RIG"), (2, "SESSION_NOT_OPEN")]
    assert await line.texts_asked() == []
    assert line.stream.num_sessions == 0


async def test_open_names_the_session_s_owner_to_the_engine(line: Line) -> None:
    line.open()
    opened = line.engine.events[0]
    assert isinstance(opened, Open)
    assert opened.spec.owner == line.stream.peer.owner


async def test_encoder_is_told_which_peer_and_stream_asks(line: Line) -> None:
    peer = Peer(PeerLimits(), time.monotonic(), name="ipv4:10.0.0.7")
    line.stream = Stream(23, line.models, peer=peer)
    line.open()
    line.send(2, edit_prompts=WALK)
    await until_true(lambda: line.prompts.askers)
    await line.encoded()
    assert line.prompts.askers == [Asker("ipv4:10.0.0.7", 23)]


async def test_open_refused_as_overloaded_has_no_prompts_encoded(line: Line) -> None:
    line.engine.most_steps = 0
    line.send(1, open=session_pb2.OpenSession(prompts=WALK.upsert))
    assert line.refusals() == [(1, "OVERLOADED")]
    assert await line.texts_asked() == []
    assert line.stream.num_sessions == 0


async def test_overloaded_engine_refuses_an_open_before_the_rest_is_checked(line: Line) -> None:
    line.engine.most_steps = 3
    line.stream.other_servers = lambda _: (OtherServer("b:50051", ""),)
    unreadable = session_pb2.OpenSession(prompts=WALK.upsert, denoise_steps=4, lookahead_frames=7)
    charged = line.stream.budget.charged
    line.send(1, open=unreadable)
    assert line.refusals() == [(1, "OVERLOADED")]
    told = line.updates()[-1].outcome
    assert "with 4 denoising steps" in told.message
    assert told.retry_after.seconds == 2
    assert [each.address for each in told.other_servers] == ["b:50051"]
    assert (line.engine.events, await line.texts_asked(), line.stream.num_sessions) == ([], [], 0)
    assert line.stream.budget.charged > charged
    line.send(1, open=session_pb2.OpenSession(denoise_steps=3))
    assert line.engine.kinds() == [Open], "its handle is free"


async def test_invalid_denoise_steps_are_refused_even_if_there_is_no_room(line: Line) -> None:
    line.engine.most_steps = 0
    line.send(1, open=session_pb2.OpenSession(denoise_steps=11))
    assert line.refusals() == [(1, "DENOISE_STEPS_OUT_OF_RANGE")]


async def test_events_waiting_for_the_encoder_are_limited(line: Line) -> None:
    line.open()
    for event_seq in range(2, 2 + MAX_WAITING_EVENTS + 2):
        line.stream.receive(
            session_pb2.SessionEvent(session=HANDLE, event_seq=event_seq, edit_prompts=WALK), time.monotonic()
        )
    too_many = session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan()] * 17)
    line.send(MAX_WAITING_EVENTS + 4, edit_prompts=too_many)  # its content is not checked any more
    line.send(MAX_WAITING_EVENTS + 5, close=session_pb2.CloseSession())
    assert [reason for _, reason in line.refusals()] == ["TOO_MANY_PENDING_EVENTS"] * 3
    await line.encoded()
    assert line.engine.kinds()[-1] is Close


async def test_waiting_bytes_of_a_peer_are_limited() -> None:
    line = Line()
    line.stream.peer.limits = PeerLimits(waiting_bytes=20_000)
    line.open()
    line.send(2, edit_prompts=WALK)  # this one is being encoded
    far = motion_pb2.RootTrajectory(positions=[1.0] * 800)
    for event_seq in range(3, 13):
        path = motion_pb2.Constraint(constraint_id=event_seq, frame=40, root_trajectory=far)  # 3.2 kB
        line.send(event_seq, edit_constraints=session_pb2.EditConstraints(upsert=[path]))
    assert line.refusals() == [(number, "TOO_MANY_PENDING_EVENTS") for number in range(9, 13)]
    assert 16_000 < line.stream.num_waiting_bytes <= 20_000
    await line.encoded()
    assert (line.stream.peer.waiting_bytes, line.stream.num_sessions) == (0, 1)
    line.send(13, edit_prompts=session_pb2.EditPrompts(upsert=[motion_pb2.PromptSpan(prompt_id=1, text="hop")]))
    line.stream.close_all(CloseReason.CLIENT)
    assert line.stream.peer.waiting_bytes == 0


async def test_an_open_refused_by_the_engine_frees_its_handle(line: Line) -> None:
    line.send(1, open=session_pb2.OpenSession())
    key = line.engine.events[0].session
    line.stream.take(Outcome(key, 1, Code.RESOURCE_EXHAUSTED, reason="SESSION_LIMIT", message="full"))
    assert line.stream.num_sessions == 0
    line.open()
    assert line.stream.num_sessions == 1


@pytest.mark.parametrize(
    ("reason", "is_named"), [("OVERLOADED", True), ("SESSION_LIMIT", True), ("STEPS_QUOTA", False)]
)
async def test_open_refused_for_lack_of_room_names_other_servers(line: Line, reason: str, is_named: bool) -> None:
    asked: list[str] = []

    def named(model_id: str) -> tuple[OtherServer, ...]:
        asked.append(model_id)
        return OtherServer("b:50051", ""), OtherServer("", "0123456789abcdef")

    line.stream.other_servers = named
    line.send(1, open=session_pb2.OpenSession())
    opened = line.engine.events[0]
    assert isinstance(opened, Open)
    line.stream.take(Outcome(opened.session, 1, Code.RESOURCE_EXHAUSTED, reason=reason, message="full"))
    told = line.updates()[-1].outcome
    assert (told.reason, told.message) == (reason, "full")
    both = [("b:50051", ""), ("", "0123456789abcdef")]
    assert [(each.address, each.routing_key) for each in told.other_servers] == (both if is_named else [])
    assert asked == ([line.catalog.facts.model_id] if is_named else [])


async def test_updates_carry_the_applied_seq_of_their_time(line: Line) -> None:
    line.open()
    key = line.engine.events[0].session
    for number in (2, 3):
        line.send(number, set_play_state=PAUSE)
    line.stream.take(Outcome(key, 3, Code.OK))
    line.stream.take(Outcome(key, 2, Code.OK))
    assert [update.applied_seq for update in line.updates()] == [1, 1, 3]


async def test_edit_with_too_many_prompts_is_refused_before_any_is_encoded(line: Line) -> None:
    line.open()
    spans = [motion_pb2.PromptSpan(prompt_id=index + 1, text=f"text {index}") for index in range(17)]
    line.send(2, edit_prompts=session_pb2.EditPrompts(upsert=spans))
    assert line.refusals() == [(2, "TOO_MANY_PROMPTS")]
    assert await line.texts_asked() == []


async def test_prompt_that_fails_to_encode_is_answered_with_an_internal_error(line: Line) -> None:
    line.open()

    async def broken(texts: Sequence[str], asker: Asker) -> None:
        raise RuntimeError(f"cannot encode {texts}")

    line.prompts.encode_all = broken  # type: ignore[assignment, method-assign]
    line.send(2, edit_prompts=WALK)
    line.stream.ready.clear()
    await line.stream.ready.wait()
    line.send(3, set_play_state=PAUSE)
    (update,) = [update for update in line.updates() if update.HasField("outcome")]
    assert (update.outcome.event_seq, update.outcome.reason) == (2, "INTERNAL")
    assert "cannot encode" not in update.outcome.message
    assert "error id" in update.outcome.message


async def test_session_of_a_client_that_does_not_read_is_closed_once() -> None:
    line = Line(make_catalog(soft_backlog_bytes=5_000, hard_backlog_bytes=10_000))
    line.open()
    key = line.engine.events[0].session
    line.stream.take(Chunk(key, 1, 0, np.zeros((1000, 3), np.float32), 0))
    (close,) = [event for event in line.engine.events if isinstance(event, Close)]
    assert close.reason is CloseReason.SLOW_READER
    line.stream.take(Chunk(key, 1, 1000, np.zeros((1000, 3), np.float32), 0))
    assert line.engine.kinds() == [Open, Close], "the session is closed once"


async def test_refusal_by_a_full_mailbox_is_passed_on(line: Line) -> None:
    line.open()
    key = line.engine.events[0].session
    line.engine.submit = lambda event: Outcome(key, 2, Code.RESOURCE_EXHAUSTED, reason="TOO_MANY_PENDING_EVENTS")  # type: ignore[method-assign]
    line.send(2, set_play_state=PAUSE)
    assert line.refusals() == [(2, "TOO_MANY_PENDING_EVENTS")]


async def test_encoding_that_ends_together_with_its_session_causes_no_failure(line: Line) -> None:
    failures: list[dict[str, object]] = []
    asyncio.get_running_loop().set_exception_handler(lambda _, context: failures.append(context))

    async def stubborn(texts: Sequence[str], asker: Asker) -> dict[str, np.ndarray]:
        """Like `asyncio.wait_for` of Python 3.11, which returns an existing result although it was cancelled."""
        with contextlib.suppress(asyncio.CancelledError):
            await line.prompts.go.wait()
        return {text: np.ones(3, np.float32) for text in texts}

    line.prompts.encode_all = stubborn  # type: ignore[assignment, method-assign]
    line.open()
    line.send(2, edit_prompts=WALK)
    for _ in range(5):
        await asyncio.sleep(0)
    line.stream.take(fault(line))
    for _ in range(5):
        await asyncio.sleep(0)
    gc.collect()  # asyncio reports a failed task when it is collected
    assert failures == []
    assert line.refusals() == [(2, "SESSION_CLOSED")]


async def test_constraints_and_paths_are_charged_to_their_stream(line: Line) -> None:
    line.open()
    now, rate = time.monotonic(), line.catalog.limits.stream_events_per_second
    line.stream.budget.charge(rate, now)
    path = motion_pb2.Constraint(constraint_id=1, root_path=motion_pb2.RootPath(positions=[1.0, 0.0]))
    waypoint = motion_pb2.Constraint(constraint_id=2, frame=90, waypoint=motion_pb2.Waypoint(x=1.0))
    edits = {2: [waypoint], 3: [path], 4: [path, waypoint, path]}
    owed = [0.0]
    for number, asked in edits.items():
        edit = session_pb2.EditConstraints(upsert=asked)
        line.stream.receive(session_pb2.SessionEvent(session=HANDLE, event_seq=number, edit_constraints=edit), now)
        owed.append(rate * line.stream.budget.owed_s(now))
    costs = [after - before for before, after in itertools.pairwise(owed)]
    assert costs == pytest.approx([CONSTRAINT_COST, CONSTRAINT_COST + PATH_COST, 3 * CONSTRAINT_COST + 2 * PATH_COST])


async def test_refused_constraints_are_charged(line: Line) -> None:
    """The last of many is invalid, which is found only after all others have been converted."""
    line.open()
    now = time.monotonic()
    before = line.stream.budget.charged
    waypoint = motion_pb2.Waypoint(x=1.0)
    asked = [motion_pb2.Constraint(constraint_id=number, frame=90, waypoint=waypoint) for number in (*range(1, 20), 0)]
    edit = session_pb2.EditConstraints(upsert=asked)
    line.stream.receive(session_pb2.SessionEvent(session=HANDLE, event_seq=2, edit_constraints=edit), now)
    assert [seq for seq, _ in line.refusals()] == [2]
    assert line.stream.budget.charged - before == 20 * CONSTRAINT_COST + REFUSAL_COST


async def test_engine_refusals_are_charged_only_if_the_client_caused_them(line: Line) -> None:
    line.open()
    key, before = line.engine.events[0].session, line.stream.budget.charged
    line.stream.take(Outcome(key, 2, Code.NOT_FOUND, reason="UNKNOWN_CONSTRAINT"))
    assert line.stream.budget.charged - before == REFUSAL_COST
    fault = Outcome(key, 3, Code.INTERNAL, reason="INTERNAL")
    line.stream.take(fault, session_closed().outcome(key, 4), Outcome(key, 5, Code.OK))
    assert line.stream.budget.charged - before == REFUSAL_COST, "none of these is its client's fault"
