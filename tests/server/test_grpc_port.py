"""The gRPC port: closed and opened again, as when a server has lost its engine and others can take its clients."""

from __future__ import annotations

import asyncio
from pathlib import Path

import grpc
import grpc.aio
import pytest
from grpc_health.v1 import health_pb2, health_pb2_grpc

from motiongen_server import grpc_port
from motiongen_server.grpc_port import GrpcPort
from motiongen_server.identity.tls import ServerTls, TlsFiles
from motiongen_server.rpc.calls.health import Health
from motiongen_server.rpc.starting import StartingService
from motiongen_server.settings import SettingError
from tests.server.application import NOT_SERVING, SERVING, config
from tests.server.identity.files import client_credentials, copy_pair
from tests.waiting import LIMIT_S, try_again, until_true


def port_of(tls: ServerTls | None = None, **settings: object) -> GrpcPort:
    health = Health()
    health.set("", SERVING)
    return GrpcPort(config(host="127.0.0.1", **settings), tls, StartingService(), health)


async def connects(number: int) -> bool:
    try:
        _, writer = await asyncio.open_connection("127.0.0.1", number)
    except ConnectionError:
        return False
    writer.close()
    return True


async def health_at(number: int, credentials: grpc.ChannelCredentials | None = None) -> int:
    address = f"127.0.0.1:{number}"
    if credentials is None:
        channel = grpc.aio.insecure_channel(address)
    else:
        channel = grpc.aio.secure_channel(address, credentials)
    async with channel:
        request = health_pb2.HealthCheckRequest()
        return int((await health_pb2_grpc.HealthStub(channel).Check(request, wait_for_ready=True)).status)


async def test_closed_port_refuses_connections_and_reopens_under_its_number() -> None:
    async with asyncio.timeout(LIMIT_S):
        port = port_of()
        await port.open()
        number = port.number
        assert number > 0
        assert await health_at(number) == SERVING
        await port.close(None)
        assert not port.is_open
        assert not await connects(number)
        await port.open()
        assert (port.is_open, port.number) == (True, number)
        assert await health_at(number) == SERVING
        await port.close(None)
        await port.close(None)


async def test_grpc_server_that_ends_by_itself_is_replaced(caplog: pytest.LogCaptureFixture) -> None:
    async with asyncio.timeout(LIMIT_S):
        port = port_of()
        await port.open()
        number, ended = port.number, port._server
        assert ended is not None
        await ended._server.shutdown(None)  # type: ignore[attr-defined]  # as gRPC does when its loop fails
        await until_true(lambda: port._server is not ended)
        assert (port.is_open, port.number, await health_at(number)) == (True, number, SERVING)
        await port.close(None)
        assert not await connects(number)
    assert [record.levelname for record in caplog.records if record.name == grpc_port.__name__] == ["ERROR"]


async def test_port_with_tls_reopens_while_its_files_are_half_written(tmp_path: Path) -> None:
    async with asyncio.timeout(LIMIT_S):
        port = port_of(ServerTls(TlsFiles(*copy_pair("server-1", tmp_path))))
        await port.open()
        assert await health_at(port.number, client_credentials()) == SERVING
        await port.close(None)
        (tmp_path / "server.key").write_text("half of a")
        await port.open()
        assert await health_at(port.number, client_credentials()) == SERVING
        await port.close(None)


async def test_shutting_lets_calls_go_on_for_the_grace_and_refuses_connections() -> None:
    async with asyncio.timeout(LIMIT_S):
        port = port_of()
        await port.open()
        async with grpc.aio.insecure_channel(f"127.0.0.1:{port.number}") as channel:
            watch = health_pb2_grpc.HealthStub(channel).Watch(health_pb2.HealthCheckRequest())
            assert (await watch.read()).status == SERVING
            port.shut(LIMIT_S)
            assert not port.is_open
            while await connects(port.number):
                await try_again()
            port._health.set("", NOT_SERVING)
            assert (await watch.read()).status == NOT_SERVING, "the call goes on"
            watch.cancel()
            await port.open()  # waits for the earlier calls to end
            assert await health_at(port.number) == NOT_SERVING
        await port.close(None)


async def test_taken_address_is_reported() -> None:
    async with asyncio.timeout(LIMIT_S):
        first = port_of()
        await first.open()
        with pytest.raises(SettingError, match="cannot listen"):
            await port_of(port=first.number).open()
        await first.close(None)
