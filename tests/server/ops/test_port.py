"""The port of operations: how many connections it has, whatever they do or do not say."""

from __future__ import annotations

import asyncio
import contextlib
import socket

import pytest
from starlette.applications import Starlette

from motiongen_server.identity.tls import TlsFiles, server_context
from motiongen_server.ops.http import MOST_CONNECTIONS
from motiongen_server.ops.port import OpsPort
from tests.server.identity.files import CERTIFICATES
from tests.waiting import LIMIT_S, until_true

SOON_S = 20.0
"""Less than the minute after which asyncio gives a handshake up."""
PAIR = TlsFiles(str(CERTIFICATES / "server-1.pem"), str(CERTIFICATES / "server-1.key"))


def is_held(connection: socket.socket) -> bool:
    try:
        return connection.recv(1) != b""
    except BlockingIOError:
        return True
    except OSError:
        return False


@pytest.mark.parametrize("by_tls", [False, True])
async def test_who_only_connects_takes_no_more_than_there_are_places(by_tls: bool) -> None:
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
            assert is_held(connections[-1]), "the oldest go"
        await port.stop()
