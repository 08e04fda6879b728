"""The stream that sessions share: connecting, messages, the round trip, and servers that break the rules."""

from __future__ import annotations

import asyncio

import grpc
import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    InvalidInput,
    LinePolicy,
    MotionClient,
    ProtocolViolation,
    ServerUnavailable,
    Session,
    StreamLost,
)
from tests.client.fake_server import FakeServer
from tests.client.waiting import collect, until


async def test_catalogue_is_known_once_connected(client: MotionClient) -> None:
    assert client.catalog.models[0].model_id == "synthetic"
    assert client.catalog.rig("stick9").joint_names[0] == "Hips"


async def test_many_sessions_share_one_call(client: MotionClient, server: FakeServer) -> None:
    async def play(session: Session) -> int:
        return [frame.index async for frame in session.frames(seconds=0.5)][-1]

    async with client.stream() as stream:
        sessions = await asyncio.gather(*(stream.open(f"character {number}") for number in range(20)))
        assert await asyncio.gather(*map(play, sessions)) == [49] * 20
        assert len(stream.sessions) == 20
        ends = await asyncio.gather(*(session.close() for session in sessions))
        assert {end.reason for end in ends} == {"client"}
        assert stream.sessions == ()
    assert len(server.streams) == 1


@pytest.mark.parametrize("code", [grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.INTERNAL])
async def test_stream_lost_for_good_raises_in_every_session_and_edit(server: FakeServer, code: grpc.StatusCode) -> None:
    async with MotionClient(server.address, policy=LinePolicy(recover_s=0)) as client:
        await check_that_a_loss_is_raised(client, server, code)


async def check_that_a_loss_is_raised(client: MotionClient, server: FakeServer, code: grpc.StatusCode) -> None:
    one, two = await client.open("one"), await client.open("two")
    server.refuse = lambda event: server.stream.fail(code) or ""  # type: ignore[func-returns-value]
    with pytest.raises(StreamLost, match=f"{code.name}: as the test wished"):
        await one.set_prompt("never answered")
    with pytest.raises(StreamLost):
        await collect(one.frames())
    with pytest.raises(StreamLost):
        await collect(two.frames(realtime=False))
    assert two.playback.playhead == two.playback.buffered_to - 1, "the frames received were played"
    with pytest.raises(StreamLost):
        one.set_prompt("again")


async def test_repeated_plan_number_raises_protocol_violation(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    notice = session_pb2.PlanNotice(plan=1, valid_from=0, cause=session_pb2.PLAN_CAUSE_EDIT)
    server.stream.push(session.handle, plan=notice)
    with pytest.raises(ProtocolViolation, match="plans must rise"):
        async for _ in session.frames():
            pass


async def test_unknown_updates_and_sessions_are_ignored(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.stream.push(session.handle)
    server.stream.push(999, closed=session_pb2.SessionClosed())
    assert len([frame async for frame in session.frames(seconds=0.1)]) == 10


async def test_event_too_big_for_a_message_is_refused_and_takes_no_number(client: MotionClient) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="at most 3686 bytes"):
        session.add_trajectory(np.zeros((1000, 2)), first_frame=10)
    assert (await session.set_prompt("still in order")).event_seq == 2


async def test_edits_beyond_one_message_are_all_answered_in_order(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    edits = [session.set_prompt("x" * 90) for _ in range(200)]
    assert [(await edit).event_seq for edit in edits] == list(range(2, 202))


async def test_failed_connect_names_the_address() -> None:
    with pytest.raises(ServerUnavailable, match=r"127\.0\.0\.1:1: no answer within 0\.2 s\. Is it running"):
        await MotionClient("127.0.0.1:1", connect_timeout_s=0.2).connect()


async def test_failed_connect_over_tls_says_what_a_certificate_needs() -> None:
    client = MotionClient("127.0.0.1:1", credentials=grpc.ssl_channel_credentials(), connect_timeout_s=0.2)
    with pytest.raises(ServerUnavailable, match="its certificate must name this address"):
        await client.connect()


@pytest.mark.parametrize("address", ["", "localhost", "localhost:", "localhost:0", "localhost:x", ":50051"])
def test_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(InvalidInput, match="host:port"):
        MotionClient(address)


@pytest.mark.parametrize("report_hz", [0.5, 6.0])
async def test_report_rates_out_of_range_are_refused(client: MotionClient, report_hz: float) -> None:
    with pytest.raises(InvalidInput, match="from 1 to 5"):
        client.stream(report_hz=report_hz)


async def test_round_trip_is_measured(client: MotionClient) -> None:
    time = asyncio.get_running_loop().time
    began_s = time()
    async with client.stream() as stream:
        assert 0 < await until(lambda: stream.round_trip_s) <= time() - began_s


async def test_second_ping_reports_the_round_trip_to_the_server(client: MotionClient, server: FakeServer) -> None:
    time = asyncio.get_running_loop().time
    began_s = time()
    async with client.stream():
        first, second = (await until(lambda: server.stream.pings if len(server.stream.pings) > 1 else None))[:2]
    assert not first.HasField("round_trip")
    assert 0 < second.round_trip.ToTimedelta().total_seconds() <= time() - began_s


async def test_plan_before_the_session_is_opened_raises_protocol_violation(
    client: MotionClient, server: FakeServer
) -> None:
    def answer_with_a_plan(event: session_pb2.SessionEvent) -> str:
        server.stream.push(event.session, plan=session_pb2.PlanNotice(plan=1))
        return ""

    server.refuse = answer_with_a_plan
    with pytest.raises(ProtocolViolation, match="before the session was opened"):
        await client.open("a person walks")


async def test_rig_missing_from_the_catalogue_raises_protocol_violation(
    client: MotionClient, server: FakeServer
) -> None:
    def open_on_another(event: session_pb2.SessionEvent) -> str:
        server.stream.push(event.session, opened=session_pb2.SessionOpened(rig_id="other"))
        return ""

    server.refuse = open_on_another
    with pytest.raises(ProtocolViolation, match="no rig is called 'other'"):
        await client.open("a person walks")


async def test_use_of_a_stream_that_was_closed_says_that_it_was_closed_here(client: MotionClient) -> None:
    async with client.stream() as stream:
        await stream.open("a person walks")
    for use in (stream.open("another"), stream.ready()):
        with pytest.raises(StreamLost, match="the stream was closed here"):
            await use
