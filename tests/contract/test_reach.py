"""What `motiongen-compliance` reports about an address at which it can test nothing."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import grpc.aio
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.reach import Unreachable, credentials_of, reach, token_of
from motiongen_server.identity.tls import ServerTls, TlsFiles
from tests.contract.local import LocalServer
from tests.server.identity.files import AUTHORITY, TenantsFile, copy_pair


@pytest.fixture(autouse=True)
def _in_a_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait less long than the command for what never comes."""
    monkeypatch.setattr("motiongen_compliance.target.LIMIT_S", 1.0)
    monkeypatch.setattr("motiongen_compliance.reach.PROBE_S", 1.0)


async def said_of(address: str, *by: object) -> str:
    with pytest.raises(Unreachable) as found:
        await reach(address, *by)  # type: ignore[arg-type]
    return str(found.value)


@asynccontextmanager
async def answering(first: bytes | None) -> AsyncIterator[str]:
    """An address that sends `first` on every connection and then closes it; None: it sends nothing."""
    connections: list[asyncio.StreamWriter] = []

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(writer)
        if first is not None:
            await reader.read(64)
            writer.write(first)
            writer.close()

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
    finally:
        server.close()
        for writer in connections:
            writer.transport.abort()


@pytest.mark.parametrize(
    ("first", "said"),
    [
        (None, "accepts connections, but sends nothing"),
        (b"", "closes plain-text connections; if it requires TLS, give --ca"),
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "speaks HTTP/1"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "does not speak HTTP/2; its first bytes are b'SSH-2.0-Open"),
        (b"\x15\x03\x01\x00\x02\x02\x46", "requires TLS; give --ca"),
        (bytes(3) + b"\x04" + bytes(5), "speaks HTTP/2, but does not answer gRPC calls"),
    ],
)
async def test_address_of_something_else_is_described(first: bytes | None, said: str) -> None:
    async with answering(first) as address:
        assert said in await said_of(address)


async def test_address_without_a_listener_is_reported() -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # bound, but not listening
        assert "nothing can be reached at 127.0.0.1" in await said_of(f"127.0.0.1:{free.getsockname()[1]}")


async def test_grpc_server_without_the_service_is_reported() -> None:
    server = grpc.aio.server()
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        assert "has no motiongen.v1.MotionService" in await said_of(f"127.0.0.1:{port}")
    finally:
        await server.stop(None)


async def test_catalogue_without_a_model_is_reported() -> None:
    class Empty(service_pb2_grpc.MotionServiceServicer):
        async def GetCatalog(self, request: object, context: object) -> service_pb2.GetCatalogResponse:
            return service_pb2.GetCatalogResponse()

    server = grpc.aio.server()
    service_pb2_grpc.add_MotionServiceServicer_to_server(Empty(), server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        assert "has no model" in await said_of(f"127.0.0.1:{port}")
    finally:
        await server.stop(None)


async def test_missing_tls_or_token_is_reported(tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    (tmp_path / "token").write_text(tenants.one() + "\n")
    tls = ServerTls(TlsFiles(*copy_pair("server-1", tmp_path)))
    async with LocalServer(callers=tenants.callers(), tls=tls) as server:
        assert "TLS" in await said_of(server.address)
        trusted = credentials_of(Path(AUTHORITY))
        unasked = await said_of(server.address, trusted)
        assert "UNAUTHENTICATED (CREDENTIALS_MISSING)" in unasked
        assert "--token-file" in unasked
        assert "CREDENTIALS_INVALID" in await said_of(server.address, trusted, "another")
        await reach(server.address, trusted, token_of(tmp_path / "token"))
    async with LocalServer() as plain:
        assert "no call over TLS" in await said_of(plain.address, trusted)


@pytest.mark.parametrize("content", [b"", b" \n", b"one\ntwo", b"\xff\xfe"])
def test_file_without_a_token_is_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "token").write_bytes(content)
    with pytest.raises(ValueError, match="has no token"):
        token_of(tmp_path / "token")
