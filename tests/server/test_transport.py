"""How many connections are let in, by the descriptors that the process may have, and for how long they may last."""

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
    """The soft and the hard limit of descriptors, as the process has them."""
    held = [1024, 4096]

    def set_limit(_what: int, given: tuple[int, int]) -> None:
        held[:] = given

    monkeypatch.setattr(resource, "getrlimit", lambda what: tuple(held))
    monkeypatch.setattr(resource, "setrlimit", set_limit)
    monkeypatch.setattr(transport, "open_files", lambda: 20)
    return held


def test_all_descriptors_that_may_be_had_are_asked_for_and_some_are_left(limits: list[int]) -> None:
    assert transport.allowed_connections() == 4096 - 20 - transport.RESERVED_FILES
    assert limits == [4096, 4096]


def test_no_more_are_asked_for_than_anybody_needs(limits: list[int]) -> None:
    limits[:] = [resource.RLIM_INFINITY, resource.RLIM_INFINITY]
    assert transport.allowed_connections() < transport.MOST_FILES


def test_too_few_are_a_setting_that_is_named(limits: list[int]) -> None:
    limits[:] = [100, 150]
    with pytest.raises(SettingError, match="may open 150 files; it needs 180 or more for 32 clients"):
        transport.allowed_connections()


def test_descriptors_are_counted() -> None:
    assert transport.open_files() > 3


def test_clients_may_ask_once_a_second_and_stay_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    made: dict[str, int] = {}
    monkeypatch.setattr(grpc.aio, "server", lambda options, **_: made.update(options))
    transport.make_grpc_server(ServerConfig())
    assert made["grpc.http2.min_ping_interval_without_data_ms"] <= 1000
    assert made["grpc.http2.max_ping_strikes"] > 0, "who asks faster for long is cut off"
    assert made["grpc.keepalive_permit_without_calls"] == 1
    assert not any("max_connection_age" in name for name in made)


async def test_a_message_that_unpacks_to_more_than_a_message_may_have_is_not_unpacked() -> None:
    """Older versions of gRPC unpacked all of it first, and then said how much it was."""
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


async def test_who_connects_to_the_port_of_operators_takes_no_more_descriptors_than_they_have() -> None:
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
