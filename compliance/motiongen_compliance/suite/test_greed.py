"""Clients that send too much, and hellos with extreme values."""

from __future__ import annotations

import grpc
import pytest
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import service_pb2
from motiongen_compliance.messages import PAUSE, addressed, close
from motiongen_compliance.target import Scene, Target


@pytest.mark.parametrize("seconds", [10**18, -(10**18), 0, 3600])
async def test_any_flush_interval_is_clamped_to_the_allowed_range(target: Target, seconds: int) -> None:
    talk = target.stream()
    hello = service_pb2.ClientHello()
    hello.flush_interval.seconds = seconds
    await talk.say(service_pb2.StreamMotionRequest(hello=hello))
    await talk.until(lambda: bool(talk.responses))
    await talk.open(1)
    await talk.plays_on(1)


async def test_too_long_client_agent_ends_only_its_own_stream(scene: Scene, target: Target) -> None:
    talk = target.stream()
    await talk.say(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello(client_agent="x" * 129)))
    assert await talk.to_the_end() is grpc.StatusCode.INVALID_ARGUMENT
    status, info = await rpc_status.aio.from_call(talk.call), error_details_pb2.ErrorInfo()
    assert status.details[0].Unpack(info)
    assert info.reason == "CLIENT_AGENT_TOO_LONG"
    await scene.others_play_on()


async def test_close_is_accepted_however_fast_the_events_before_it_came(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    last = 2 * round(talk.catalog.limits.max_events_per_second) + 20
    await talk.send(*(addressed(PAUSE, 1, number) for number in range(2, last)), addressed(close(), 1, last))
    await talk.until(lambda: heard.closed is not None)
    assert any(outcome.reason == "TOO_MANY_EVENTS" for outcome in heard.outcomes)
    await talk.plays_on(2)
