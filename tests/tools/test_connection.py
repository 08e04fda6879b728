"""How commands connect to a server: TLS over Unix sockets, and files that must be PEM."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import grpc
import grpc.aio
import pytest

from motiongen_client import InvalidInput
from motiongen_client.channel import ChannelSettings
from motiongen_tools.connection import Connection
from tests.waiting import LIMIT_S

CERTIFICATES = Path(__file__).parents[1] / "certificates"


@pytest.fixture
async def tls_socket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[str]:
    """The address of a server with TLS on a Unix socket, with a certificate for localhost."""
    monkeypatch.chdir(tmp_path)  # the path of a socket must be short
    pair = ((CERTIFICATES / "server-1.key").read_bytes(), (CERTIFICATES / "server-1.pem").read_bytes())
    server = grpc.aio.server()
    server.add_secure_port("unix:motion.sock", grpc.ssl_server_credentials([pair]))
    await server.start()
    yield "unix:motion.sock"
    await server.stop(None)


@pytest.mark.parametrize("chosen", [(), (("grpc.ssl_target_name_override", "localhost"),)])
async def test_tls_over_a_unix_socket_expects_a_certificate_for_localhost(
    tls_socket: str, chosen: tuple[tuple[str, str], ...]
) -> None:
    authority = CERTIFICATES / "authority.pem"
    credentials = grpc.ssl_channel_credentials(authority.read_bytes())
    for channel in (
        ChannelSettings(tls_socket, credentials, options=chosen).open(),
        Connection(tls=True, authorities=authority).channel(tls_socket, [("grpc.enable_retries", 0)]),
    ):
        async with asyncio.timeout(LIMIT_S), channel:
            await channel.channel_ready()


@pytest.mark.parametrize("content", [b"", b"not PEM", b"\x30\x82\x01"])
@pytest.mark.parametrize("name", ["authorities", "certificate", "key"])
def test_a_file_that_is_not_pem_is_refused_by_name(name: str, content: bytes, tmp_path: Path) -> None:
    (tmp_path / "given").write_bytes(content)
    connection = Connection(tls=True, **{name: tmp_path / "given"})
    with pytest.raises(InvalidInput, match=r"tls-.*given' was given; allowed is a PEM file"):
        connection.client("localhost:1")


async def test_failed_handshake_is_reported_once_by_the_command() -> None:
    async def answer_in_plain_text(_reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()

    server = await asyncio.start_server(answer_in_plain_text, "127.0.0.1", 0)
    async with server:
        address = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
        command = ["-m", "motiongen_tools", "catalog", "--server", address, "--tls", "--connect-timeout", "1"]
        process = await asyncio.create_subprocess_exec(sys.executable, *command, stderr=asyncio.subprocess.PIPE)
        _, said = await process.communicate()
    assert process.returncode == 1
    assert said.decode().startswith(f"error: no motiongen server answers at {address}")
    assert said.count(b"\n") == 1
