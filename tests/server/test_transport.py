"""Limits of connections: their number by the process's descriptors, keepalive pings, and message sizes."""

from __future__ import annotations

import asyncio
import contextlib
import resource

import grpc
import grpc.aio
import pytest

from motiongen_server import transport
from motiongen_server.config import ServerConfig
from motiongen_server.settings import SettingError
from tests.raw_calls import PREFACE
from tests.server.application import config, running
from tests.waiting import LIMIT_S


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The soft and the hard limit of descriptors that the process is made to see."""
    held = [1024, 4096]

    def set_limit(_what: int, given: tuple[int, int]) -> None:
        held[:] = given

    monkeypatch.setattr(resource, "getrlimit", lambda what: tuple(held))
    monkeypatch.setattr(resource, "setrlimit", set_limit)
    monkeypatch.setattr(transport, "open_files", lambda: 20)
    return held


def test_soft_limit_is_raised_to_the_hard_one_and_a_reserve_kept(limits: list[int]) -> None:
    assert transport.allowed_connections() == 4096 - 20 - transport.RESERVED_FILES
    assert limits == [4096, 4096]


def test_infinite_limit_allows_a_bounded_number_of_connections(limits: list[int]) -> None:
    limits[:] = [resource.RLIM_INFINITY, resource.RLIM_INFINITY]
    assert transport.allowed_connections() < transport.MOST_FILES


def test_too_few_descriptors_are_refused_with_the_number_needed(limits: list[int]) -> None:
    limits[:] = [100, 150]
    with pytest.raises(SettingError, match="may open 150 files; it needs 180 or more for 32 clients"):
        transport.allowed_connections()


def test_open_descriptors_are_counted() -> None:
    assert transport.open_files() > 3


def test_pings_are_allowed_once_a_second_and_connections_have_no_age_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, int] = {}
    monkeypatch.setattr(grpc.aio, "server", lambda options, **_: made.update(options))
    transport.make_grpc_server(ServerConfig())
    assert made["grpc.http2.min_ping_interval_without_data_ms"] <= 1000
    assert made["grpc.http2.max_ping_strikes"] > 0, "a client that pings faster for long is disconnected"
    assert made["grpc.keepalive_permit_without_calls"] == 1
    assert not any("max_connection_age" in name for name in made)


async def test_compressed_message_larger_than_the_limit_is_not_unpacked() -> None:
    """Older versions of gRPC unpacked it completely, and gave its full size in the error."""
    bomb = bytes(32 << 20)
    async with (
        asyncio.timeout(LIMIT_S),
        running(config()) as application,
        grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}", compression=grpc.Compression.Gzip) as channel,
    ):
        with pytest.raises(grpc.aio.AioRpcError) as refused:
            await channel.unary_unary("/motiongen.v1.MotionService/GetCatalog")(bomb)
        assert refused.value.code() is grpc.StatusCode.RESOURCE_EXHAUSTED
        assert str(len(bomb)) not in str(refused.value.details())


async def test_connections_to_the_admin_port_are_bounded() -> None:
    async with running(config(admin_listen="127.0.0.1:0")) as application:
        held, num_answered = [], 0
        for _ in range(transport.ADMIN_CONNECTIONS + 4):
            reader, writer = await asyncio.open_connection("127.0.0.1", application.admin_port)
            held.append(writer)
            writer.write(PREFACE)
            with contextlib.suppress(ConnectionError):
                num_answered += await reader.read(1) != b""
        assert num_answered == transport.ADMIN_CONNECTIONS
        for writer in held:
            writer.transport.abort()
