"""Waiting memory of streams, clips and parked sessions together: which give memory up first, and which are ended."""

from __future__ import annotations

import asyncio
import time
from dataclasses import replace

import grpc.aio
import pytest

from motiongen.v1 import service_pb2, session_pb2
from motiongen.v1.service_pb2_grpc import MotionServiceStub
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.types import Chunk, Close, SessionKey
from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.waiting_memory import WaitingMemory
from motiongen_server.rpc.clip.holding import OBJECT_BYTES, Holding
from motiongen_server.rpc.limits import ServiceLimits
from motiongen_server.rpc.sessions.kept_sessions import KeptSessions
from motiongen_server.rpc.stream_metrics import NoStreamMetrics
from motiongen_server.rpc.streams.watch import StreamWatch
from tests.contract.local import LocalServer
from tests.server.engine.fakes import ROW_WIDTH
from tests.server.rpc.clip.test_calls import clip, generate, refusal
from tests.server.rpc.sessions.test_kept_answers import placed
from tests.server.rpc.sessions.test_kept_sessions import resume, token_of
from tests.server.rpc.streams.test_event_order import PAUSE, Engine, Line
from tests.server.rpc.streams.test_stream_watch import FRAMES, connected, holding, talk_on
from tests.waiting import LIMIT_S, until_true

CLIP = SessionKey(9, 0)


def chunk(num_frames: int) -> Chunk:
    return Chunk(CLIP, 1, 0, FRAMES[:num_frames], num_frames)


def call_with(num_frames: int) -> Holding:
    """A call for a clip with that many frames which its client has not read."""
    call = Holding(0)
    call.put([chunk(num_frames)])
    return call


async def test_streams_and_clips_count_together_and_the_largest_is_ended() -> None:
    stream, calls = holding(300), {7: call_with(100), 8: call_with(500)}
    memory = WaitingMemory(0, {1: stream})
    for number, call in calls.items():
        memory.begin(number, call)
    total = stream.num_waiting_bytes + sum(call.num_waiting_bytes for call in calls.values())
    assert memory.num_bytes == total
    memory = WaitingMemory(total - 1, {1: stream})
    for number, call in calls.items():
        memory.begin(number, call)
    memory.bound()
    assert stream.refusal is None
    assert calls[7].refusal is None
    assert calls[8].refusal is not None
    assert (calls[8].refusal.code, calls[8].refusal.reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER")
    assert memory.num_bytes == stream.num_waiting_bytes + calls[7].num_waiting_bytes


async def test_outputs_of_a_clip_count_until_written_and_not_after_its_end() -> None:
    noted: list[int] = []
    call = Holding(1000, noted.append)
    call.put([chunk(10), chunk(20)])
    one, two = (OBJECT_BYTES + frames * ROW_WIDTH * 4 for frames in (10, 20))
    assert call.num_waiting_bytes == 1000 + one + two
    output = await call.next()
    assert call.num_waiting_bytes == 1000 + one + two, "the first is being written"
    call.done(output)
    assert call.num_waiting_bytes == 1000 + two
    ended: list[bool] = []
    call.cut = lambda: ended.append(True)
    call.fail(RuntimeError("a fault"))
    assert call.refusal is not None
    assert call.refusal.code is grpc.StatusCode.INTERNAL
    call.put([chunk(30)])
    assert (call.num_waiting_bytes, ended, noted) == (1000, [True], [one + two, -one])


async def test_account_is_bounded_at_once_between_two_looks_of_the_watch() -> None:
    memory = WaitingMemory(10_000, {})
    calls = [Holding(0, memory.note) for _ in range(4)]
    for number, call in enumerate(calls):
        memory.begin(number, call)
    for call in calls:
        call.put([chunk(3_000 // (4 * ROW_WIDTH))])
    assert sum(call.refusal is not None for call in calls) == 1
    assert 6_000 < memory.num_bytes <= 10_000


class Faulty:
    """A holder of memory that fails when it is to be ended."""

    refusal: StreamRefused | None = None
    num_waiting_bytes = 10_000
    peer_name = ""

    def __init__(self) -> None:
        self.failures: list[Exception] = []

    def refuse(self, refusal: StreamRefused) -> None:
        raise RuntimeError(refusal.reason)

    def fail(self, error: Exception) -> None:
        self.failures.append(error)


async def test_fault_in_ending_one_holder_does_not_save_the_others() -> None:
    faulty, call = Faulty(), call_with(10)
    memory = WaitingMemory(0, {1: faulty})
    memory.begin(2, call)
    memory.bound()
    assert [str(error) for error in faulty.failures] == ["SLOW_READER"]
    assert call.refusal is not None


class Resumes(NoStreamMetrics):
    """Counts what became of sessions whose stream was lost."""

    def __init__(self) -> None:
        self.counted: list[str] = []

    def count_resume(self, how: str) -> None:
        self.counted.append(how)


@pytest.fixture
def resumes() -> Resumes:
    return Resumes()


@pytest.fixture
async def kept(resumes: Resumes) -> KeptSessions:
    return KeptSessions(30.0, resumes)


def parked(kept: KeptSessions, number: int = 1) -> tuple[Engine, str]:
    """The engine and the token of a parked session whose client has not confirmed an answer with placements.

    number: of the stream that carried it.
    """
    line = Line(kept=kept, number=number)
    line.open()
    line.send(2, set_play_state=PAUSE)
    line.stream.take(replace(placed(2), session=line.engine.events[0].session))
    line.stream.lose()
    return line.engine, token_of(line)


async def test_answers_kept_for_absent_clients_count_too(kept: KeptSessions) -> None:
    memory = WaitingMemory(1 << 20, {}, kept)
    assert memory.is_idle
    parked(kept)
    assert memory.num_bytes > 256 * 300
    assert not memory.is_idle


async def test_parked_sessions_give_up_placements_before_a_stream_is_ended(kept: KeptSessions) -> None:
    stream = holding(300)
    memory = WaitingMemory(stream.num_waiting_bytes + 1000, {stream.number: stream}, kept)
    engine, token = parked(kept)
    memory.bound()
    assert stream.refusal is None
    assert memory.num_bytes <= stream.num_waiting_bytes + 1000
    entry = kept.find(token)
    assert entry is not None
    assert [(answer.event_seq, answer.placements) for answer in entry.answers] == [(2, ())], "the answer itself is kept"
    assert resume(kept, engine, token).refusals() == []


async def test_parked_sessions_are_closed_for_a_stream_down_to_their_part(kept: KeptSessions, resumes: Resumes) -> None:
    sessions = [parked(kept, number) for number in range(1, 9)]
    kept.let_go(kept.num_waiting_bytes // 2, 0)
    assert (kept.num_parked, resumes.counted) == (8, []), "placements and warnings were enough"
    for entry in kept.by_peer()[""]:
        entry.let_go_of_places()
    waiting = kept.num_waiting_bytes
    stream = holding(waiting // (4 * ROW_WIDTH))
    assert waiting < stream.num_waiting_bytes < 1.5 * waiting
    memory = WaitingMemory(2 * waiting, {stream.number: stream}, kept)
    memory.bound()
    assert stream.refusal is None
    assert memory.num_bytes <= 2 * waiting
    assert kept.num_parked < 8
    assert resumes.counted == ["let_go"] * (8 - kept.num_parked)
    for number, (engine, token) in enumerate(sessions, 1):
        is_closed = engine.kinds()[-1] is Close
        assert (kept.find(token) is None) == is_closed
        refusals = resume(kept, engine, token, attempt=20 + number).refusals()
        assert refusals == ([(1, "SESSION_NOT_KEPT")] if is_closed else [])


async def test_parked_session_is_not_closed_for_what_others_do_not_read(kept: KeptSessions, resumes: Resumes) -> None:
    """Its client has only lost its connection, and to end it would free next to nothing."""
    stream = holding(300)
    memory = WaitingMemory(stream.num_waiting_bytes, {stream.number: stream}, kept)
    engine, token = parked(kept)
    memory.bound()
    assert stream.refusal is not None
    assert (kept.num_parked, resumes.counted) == (1, [])
    assert resume(kept, engine, token).refusals() == []


async def test_let_go_takes_from_the_session_that_holds_most(kept: KeptSessions) -> None:
    small, large = Line(kept=kept), Line(kept=kept, number=2)
    for line, num_answers in ((small, 1), (large, 2)):
        line.open()
        for event_seq in range(2, 2 + num_answers):
            line.send(event_seq, set_play_state=PAUSE)
            line.stream.take(replace(placed(event_seq), session=SessionKey(line.number, 7)))
        line.stream.lose()
    entries = [kept.find(token_of(line)) for line in (small, large)]
    before = [entry.held_bytes for entry in entries if entry is not None]
    kept.let_go(1000, 0)
    after = [entry.held_bytes for entry in entries if entry is not None]
    assert after[0] == before[0]
    assert after[1] < before[1]


async def test_message_being_written_counts_until_it_is_written(kept: KeptSessions) -> None:
    stream = holding(300)
    waiting = stream.num_waiting_bytes
    assert stream.next_response() is not None
    assert 0.9 * waiting < stream.num_waiting_bytes < 1.1 * waiting
    stream.note_written()
    assert stream.num_waiting_bytes == 0
    stream.reply(service_pb2.StreamMotionResponse())
    assert stream.num_waiting_bytes > 0


async def test_unread_clip_is_ended_where_too_much_waits_and_a_stream_plays_on() -> None:
    """The chunks fit into gRPC's own buffers, so the account is checked while they are made."""
    limits = ServiceLimits(max_waiting_bytes=4_000)
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(engine_config=EngineConfig(max_clips=64), service_limits=limits) as server,
        connected(server) as (channel, catalog),
    ):
        talk = await talk_on(channel, catalog).hello()
        await talk.open(1)
        code, info, _ = await refusal(server, clip(400, 16))
        assert (code, info.reason) == (grpc.StatusCode.RESOURCE_EXHAUSTED, "SLOW_READER")
        await until_true(lambda: server.engine.num_sessions == 1)
        await talk.plays_on(1)
        assert len((await generate(server, clip(8)))[0].rows) == 8


async def test_watch_looks_at_calls_while_there_is_no_stream() -> None:
    """The request of a call counts as long as its prompts are not encoded."""
    text = "a prompt"
    asked = service_pb2.GenerateClipRequest(frame_count=8, open=session_pb2.OpenSession(request_id="r" * 60))
    asked.open.prompts.add(prompt_id=1, text=text)
    async with asyncio.timeout(LIMIT_S), LocalServer() as server:
        gate = asyncio.Event()

        async def encode(*_: object) -> None:
            await gate.wait()

        server.prompts.encode_all = encode  # type: ignore[method-assign, assignment]
        async with grpc.aio.insecure_channel(server.address) as channel:
            call = MotionServiceStub(channel).GenerateClip(asked)
            await until_true(lambda: server.service.num_waiting_bytes == 2 * asked.ByteSize())
            assert server.service.watch._timer is not None
            call.cancel()
            await until_true(lambda: not server.service.num_waiting_bytes)
            await until_true(lambda: server.service.watch._timer is None)


async def test_watch_without_an_account_of_its_own_counts_its_streams() -> None:
    stream = holding(300)
    StreamWatch(ServiceLimits(max_waiting_bytes=10), {stream.number: stream}).look(time.monotonic())
    assert stream.refusal is not None
