"""Requests for clips whose clients do not half-close: they are charged, and their memory is counted to the end."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterable
from functools import partial

import grpc
import grpc.aio
import pytest

from motiongen_server.rpc import handlers
from motiongen_server.rpc.budgets.loop_time import UNLIMITED
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.calls.requests import Requests
from motiongen_server.rpc.limits import PeerLimits, ServiceLimits
from tests.contract.local import LocalServer
from tests.server.rpc.clip.test_calls import clip
from tests.waiting import LIMIT_S, until_true

PATH = "/motiongen.v1.MotionService/GenerateClip"
LONG = b"\x7a\x80\x80\x20" + b"a" * (1 << 19)
"""An unknown field of half a mebibyte."""


@pytest.fixture(autouse=True)
def endless_wait_for_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handlers, "Requests", partial(Requests, 1e6))


def peer_of(server: LocalServer) -> Peer:
    return server.service._admission._peers.find("ipv4:127.0.0.1:1", time.monotonic())


async def begun(channel: grpc.aio.Channel, data: bytes) -> grpc.aio.StreamStreamCall:
    """A call that has sent this and has not half-closed."""
    call = channel.stream_stream(PATH)()
    await call.write(data)
    return call


async def ends(calls: Iterable[grpc.aio.StreamStreamCall]) -> list[tuple[grpc.StatusCode, str]]:
    """The code of each call, and the reason from its metadata."""
    told = [(await call.code(), str(await call.trailing_metadata())) for call in calls]
    reasons = ("SLOW_READER", "TOO_MUCH_UNPAID", "REQUEST_LATE")
    return [(code, next(reason for reason in reasons if reason in text)) for code, text in told]


async def test_request_is_charged_and_counted_before_its_client_half_closes() -> None:
    # The budgets are not replenished while the test lasts.
    peer_limits = PeerLimits(calls_per_second=1e-3, bytes_per_second=1e-3)
    limits = ServiceLimits(loop_share=UNLIMITED, peer=peer_limits)
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        call = await begun(channel, LONG)
        await until_true(lambda: server.service.num_waiting_bytes == len(LONG))
        peer, now = peer_of(server), time.monotonic()
        assert peer.held.num_bytes == len(LONG)
        assert peer.calls.owed_s(now) * 1e-3 == pytest.approx(1 + len(LONG) / 16_384, rel=0.01)
        assert peer.bytes.owed_s(now) * 1e-3 == pytest.approx(len(LONG), rel=0.01)
        await call.done_writing()
        assert await call.code() is grpc.StatusCode.INVALID_ARGUMENT
        await until_true(lambda: server.service.num_waiting_bytes == 0)
        assert peer.held.num_bytes == 0


async def test_peer_is_not_forgotten_while_a_request_is_awaited() -> None:
    """Otherwise an address could have its quota of clips once more with each call that waits for long."""
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer() as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        peer = peer_of(server)
        assert peer.is_idle(time.monotonic())
        call = channel.stream_stream(PATH)()
        await until_true(lambda: not peer.is_idle(time.monotonic() + 60))
        call.cancel()
        await until_true(lambda: peer.is_idle(time.monotonic() + 60))


@pytest.mark.parametrize(
    ("limits", "reason"),
    [
        (ServiceLimits(max_waiting_bytes=3 * len(LONG), loop_share=UNLIMITED), "SLOW_READER"),
        (ServiceLimits(peer=PeerLimits(held_bytes=3 * len(LONG)), loop_share=UNLIMITED), "TOO_MUCH_UNPAID"),
    ],
    ids=["of all", "of an address"],
)
async def test_unfinished_requests_are_ended_where_too_much_memory_is_held(limits: ServiceLimits, reason: str) -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer(service_limits=limits) as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        # All begin before the first request has come, because the fourth puts the address in debt for calls.
        calls = [channel.stream_stream(PATH)() for _ in range(8)]
        await until_true(lambda: server.service._admission._places._taken.total() == 8)
        for call in calls:
            await call.write(LONG)
        await until_true(lambda: sum(call.done() for call in calls) == 5)
        assert server.service.num_waiting_bytes == 3 * len(LONG)
        assert await ends(call for call in calls if call.done()) == [(grpc.StatusCode.RESOURCE_EXHAUSTED, reason)] * 5
        for call in calls:
            call.cancel()
        await until_true(lambda: server.service.num_waiting_bytes == 0)


async def test_clip_is_made_once_its_client_half_closes() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        LocalServer() as server,
        grpc.aio.insecure_channel(server.address) as channel,
    ):
        call = await begun(channel, clip(40).SerializeToString())
        await until_true(lambda: server.service.num_waiting_bytes)
        await call.done_writing()
        assert [response async for response in call]
        assert await call.code() is grpc.StatusCode.OK
