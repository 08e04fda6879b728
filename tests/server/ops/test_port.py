"""The operations port: limits on its connections, also on those that send nothing."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import socket
import ssl
from functools import partial
from typing import Any

import pytest
from prometheus_client import CollectorRegistry
from starlette.applications import Starlette

from motiongen_server.identity.tls import TlsFiles, server_context
from motiongen_server.ops import port as ops_port
from motiongen_server.ops.http import MOST_CONNECTIONS, ops_app
from motiongen_server.ops.pace import CONNECTIONS_A_SECOND, CONNECTIONS_OF_AN_ADDRESS, AddressPaces
from motiongen_server.ops.port import BoundedListener, OpsPort
from tests.server.identity.files import AUTHORITY, CERTIFICATES
from tests.waiting import LIMIT_S, until_true

SOON_S = 20.0
"""Less than the minute after which asyncio abandons a TLS handshake."""
PAIR = TlsFiles(str(CERTIFICATES / "server-1.pem"), str(CERTIFICATES / "server-1.key"))


def is_held(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


@pytest.mark.parametrize("by_tls", [False, True])
async def test_silent_connections_are_bounded_and_the_oldest_closed(
    by_tls: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ops_port, "CONNECTIONS_OF_AN_ADDRESS", 1000)
    monkeypatch.setattr(ops_port, "CONNECTIONS_A_SECOND", 1000)
    port = OpsPort(Starlette(), "127.0.0.1", 0, server_context(PAIR) if by_tls else None)
    async with asyncio.timeout(LIMIT_S):
        await port.start()
        with contextlib.ExitStack() as held:
            connections = []
            for _ in range(MOST_CONNECTIONS + 40):
                connections.append(held.enter_context(socket.create_connection(("127.0.0.1", port.port))))
                connections[-1].setblocking(False)
                await asyncio.sleep(0)
            async with asyncio.timeout(SOON_S):
                await until_true(lambda: sum(map(is_held, connections)) <= MOST_CONNECTIONS)
            assert is_held(connections[-1]), "the newest stays"
        await port.stop()


async def test_flood_from_one_address_is_refused_while_another_is_answered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Refused connections cost no TLS handshake."""
    handshakes = 0

    class Counted(ssl.SSLContext):
        def wrap_bio(self, *arguments: Any, **named: Any) -> ssl.SSLObject:
            nonlocal handshakes
            handshakes += 1
            return super().wrap_bio(*arguments, **named)

    context = Counted(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(PAIR.certificate, PAIR.key)
    # The clock stands still, so that no new second begins during the flood.
    monkeypatch.setattr(ops_port, "AddressPaces", partial(AddressPaces, clock=lambda: 0.0))
    port = OpsPort(ops_app(CollectorRegistry(), lambda: True, lambda: True), "127.0.0.1", 0, context)
    trusted = ssl.create_default_context(cafile=AUTHORITY)
    async with asyncio.timeout(LIMIT_S):
        await port.start()
        for _ in range(5 * CONNECTIONS_A_SECOND):
            flooding = socket.create_connection(("127.0.0.1", port.port), source_address=("127.0.0.2", 0))
            flooding.close()
            await asyncio.sleep(0)
        for _ in range(CONNECTIONS_OF_AN_ADDRESS):
            reader, writer = await asyncio.open_connection(
                "127.0.0.1", port.port, ssl=trusted, server_hostname="localhost"
            )
            writer.write(b"GET /livez HTTP/1.1\r\nHost: x\r\n\r\n")
            assert (await reader.read()).startswith(b"HTTP/1.1 200")
            writer.transport.abort()
        assert handshakes <= 2 * CONNECTIONS_OF_AN_ADDRESS
        await port.stop()


def test_flood_from_one_ipv6_network_is_refused_across_its_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ops_port, "AddressPaces", partial(AddressPaces, clock=lambda: 0.0))
    hosts = itertools.count()

    def accept(listening: socket.socket) -> tuple[socket.socket, Any]:
        host = next(hosts)
        if host > CONNECTIONS_OF_AN_ADDRESS:
            raise BlockingIOError
        return held.enter_context(socket.socket()), (f"2001:db8::{host:x}", 55000, 0, 0)

    monkeypatch.setattr(socket.socket, "accept", accept)
    with contextlib.ExitStack() as held:
        listener = held.enter_context(BoundedListener(socket.socket()))
        for _ in range(CONNECTIONS_OF_AN_ADDRESS):
            listener.accept()
        with pytest.raises(BlockingIOError):
            listener.accept()
