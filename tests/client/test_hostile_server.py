"""A server that breaks the rules of frames, says goodbye or stops answering: no reader gets a wrong frame."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_client import Frame, LinePolicy, MotionClient, ProtocolViolation, Session
from tests.client.fake_server import Character, FakeServer, FakeStream
from tests.client.synthetic import synthetic_rows
from tests.client.waiting import until
from tests.waiting import LIMIT_S

EDIT = session_pb2.PLAN_CAUSE_EDIT
Script = Callable[[FakeStream, Character], None]


def chunk(stream: FakeStream, plan: int, first_frame: int, committed_to: int, count: int = 4) -> None:
    data = synthetic_rows(plan, first_frame, count).astype("<f4").tobytes()
    stream.push(
        1,
        chunk=motion_pb2.FrameChunk(
            plan=plan,
            first_frame=first_frame,
            frame_count=count,
            committed_to=committed_to,
            data=data,
            scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
        ),
    )


def notice(stream: FakeStream, plan: int, valid_from: int) -> None:
    stream.push(1, plan=session_pb2.PlanNotice(plan=plan, valid_from=valid_from, cause=EDIT, event_seqs=[2]))


def gap(stream: FakeStream, told: Character) -> None:
    chunk(stream, told.plan, told.sent_to + 1, told.sent_to)


def replay(stream: FakeStream, told: Character) -> None:
    chunk(stream, told.plan, told.sent_to - 4, told.sent_to)


def replayed_notice(stream: FakeStream, told: Character) -> None:
    notice(stream, told.plan, told.sent_to)


def plan_of_the_past(stream: FakeStream, told: Character) -> None:
    notice(stream, told.plan + 1, 0)


def chunk_of_an_older_plan(stream: FakeStream, told: Character) -> None:
    notice(stream, told.plan + 1, told.sent_to)
    chunk(stream, told.plan, told.sent_to, told.sent_to)


def promise_taken_back(stream: FakeStream, told: Character) -> None:
    chunk(stream, told.plan, told.sent_to, 0)


def half_a_row(stream: FakeStream, told: Character) -> None:
    broken = motion_pb2.FrameChunk(
        plan=told.plan,
        first_frame=told.sent_to,
        frame_count=1,
        committed_to=told.sent_to,
        data=b"1234",
        scalar_type=motion_pb2.SCALAR_TYPE_F32_LE,
    )
    stream.push(1, chunk=broken)


async def shown(session: Session, count: int) -> list[Frame]:
    return [frame async for frame in session.frames(seconds=count / 100, realtime=False)]


def are_continuous(frames: list[Frame]) -> bool:
    """Whether the root moves 5 cm per frame, as the fake server sends it, across all plans."""
    return [round(float(frame.root_translation_m[2]) / 0.05) for frame in frames] == [f.index for f in frames]


@pytest.mark.parametrize(
    "script",
    [gap, replay, replayed_notice, plan_of_the_past, chunk_of_an_older_plan, promise_taken_back, half_a_row],
    ids=lambda script: script.__name__,
)
async def test_invalid_frames_or_plans_end_the_stream_and_no_wrong_frame_is_yielded(
    client: MotionClient, server: FakeServer, script: Script
) -> None:
    session = await client.open("walk", keep_s=None)
    frames = await shown(session, 60)

    def send_script(event: session_pb2.SessionEvent) -> str:
        """Runs on the thread that sends frames, so that none of the fake server's own messages come in between."""
        if event.HasField("set_velocity"):
            script(server.stream, server.stream.characters[1])
        return ""

    server.refuse = send_script
    session.set_velocity(0, 1)

    async def read_on() -> None:
        while True:
            frames.extend(await shown(session, 1))

    with pytest.raises(ProtocolViolation):
        await read_on()
    assert [frame.index for frame in frames] == list(range(len(frames)))
    assert are_continuous(frames)


async def test_goodbye_amid_playback_loses_no_frame(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("walk")
    frames = await shown(session, 30)
    goodbye = service_pb2.Goodbye(reason=service_pb2.GOODBYE_REASON_DRAINING)
    goodbye.grace.FromSeconds(60)
    server.stream.outgoing.put(service_pb2.StreamMotionResponse(goodbye=goodbye))
    frames += await shown(session, 170)
    assert [frame.index for frame in frames] == list(range(200))
    assert are_continuous(frames)


async def replaced_by_another_connection(server: FakeServer, say: Callable[[FakeStream], None]) -> list[FakeStream]:
    """Check that a server which answers no ping, whatever else it sends, is reconnected to without losing a frame.

    Returns its stream, and the one that replaced it.
    """
    policy = LinePolicy(ping_s=0.05, pong_timeout_s=0.05)
    async with MotionClient(server.address, policy=policy) as client:
        session = await client.open("walk", keep_s=None)
        frames = await shown(session, 30)
        silent = server.stream
        silent.answers_pings = False

        def is_left() -> bool:
            say(silent)
            return server.stream is not silent and bool(session.reopenings)

        await until(is_left)
        frames += await shown(session, 60)
    assert [frame.index for frame in frames] == list(range(90))
    return [silent, server.stream]


async def test_connection_without_pongs_is_replaced_without_losing_frames(server: FakeServer) -> None:
    await replaced_by_another_connection(server, lambda _: None)


async def test_unsolicited_pongs_neither_keep_a_connection_nor_set_the_round_trip(server: FakeServer) -> None:
    pong = service_pb2.StreamMotionResponse(pong=service_pb2.Pong(client_time_ns=-(2**62)))
    streams = await replaced_by_another_connection(server, lambda stream: stream.outgoing.put(pong))
    told = [ping.round_trip.ToSeconds() for stream in streams for ping in stream.pings]
    assert all(0 <= seconds < LIMIT_S for seconds in told)


async def test_pong_sent_again_and_again_does_not_keep_a_connection(server: FakeServer) -> None:
    def say(stream: FakeStream) -> None:
        pong = service_pb2.Pong(client_time_ns=stream.pings[0].client_time_ns)
        stream.outgoing.put(service_pb2.StreamMotionResponse(pong=pong))

    await replaced_by_another_connection(server, say)
