"""Clients that ask for much and read nothing, and greetings that are well formed but absurd."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import service_pb2, session_pb2
from tests.contract.conftest import Scene, Target
from tests.contract.local import LocalServer
from tests.contract.talk import PAUSE, addressed, close


async def test_answers_to_a_flood_that_nobody_reads_stay_within_the_limit(
    local_server: LocalServer, local: Target
) -> None:
    other, flooder = await local.talk(), await local.talk()
    await other.open(1)
    limits = local_server.service._models.limits
    nothing = session_pb2.SessionEvent(session=5)  # four bytes that cost the server an answer of a few hundred
    request = service_pb2.StreamMotionRequest(events=[nothing] * 100_000)

    async def flood() -> None:
        while True:
            await flooder.call.write(request)

    flooding = asyncio.create_task(flood())
    stream = local_server.service._streams[2]
    while stream.send_queue.num_bytes <= limits.hard_backlog_bytes:
        await other.ping(1)  # takes its turn on the same event loop, and is no event that a session has too many of
    for _ in range(5):
        await other.plays_on(1)
        assert stream.send_queue.num_bytes < 1.1 * limits.hard_backlog_bytes
    flooding.cancel()
    flooder.call.cancel()
    while local_server.service.num_streams > 1:
        await other.ping(1)


@pytest.mark.parametrize("seconds", [10**18, -(10**18), 0, 3600])
async def test_any_flush_interval_is_moved_into_the_range(target: Target, seconds: int) -> None:
    talk = target.stream()
    hello = service_pb2.ClientHello()
    hello.flush_interval.seconds = seconds
    await talk.say(service_pb2.StreamMotionRequest(hello=hello))
    await talk.until(lambda: bool(talk.responses))
    await talk.open(1)
    await talk.plays_on(1)


async def test_a_client_s_name_that_is_too_long_ends_its_stream_alone(scene: Scene, target: Target) -> None:
    talk = target.stream()
    await talk.say(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(client_agent="x" * 129)))
    assert await talk.to_the_end() is grpc.StatusCode.INVALID_ARGUMENT
    assert "128" in (await talk.call.details() or "")
    await scene.others_play_on()


async def test_a_close_is_taken_however_fast_the_events_before_it_came(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    last = 2 * round(talk.catalog.limits.max_events_per_second) + 20
    await talk.send(*(addressed(PAUSE, 1, number) for number in range(2, last)), addressed(close(), 1, last))
    await talk.until(lambda: heard.closed is not None)
    assert any(outcome.reason == "TOO_MANY_EVENTS" for outcome in heard.outcomes)
    await talk.plays_on(2)
