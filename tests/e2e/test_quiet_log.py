"""Mistakes of clients in handshakes and headers are not logged."""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

from tests.e2e.test_drain import LIMIT_S, serving
from tests.raw_calls import answer_to
from tests.scale.replicas import SERVER
from tests.server.identity.files import TenantsFile, copy_pair

UNREADABLE = ((b"grpc-timeout", b"soon"), (b"authorization", b"Bearer \xff"))
PLAIN = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(100)


async def test_clients_without_tls_on_a_port_with_it_are_not_logged(tmp_path: Path) -> None:
    tenants = TenantsFile(tmp_path)
    tenants.one()
    certificate, key = copy_pair("server-1", tmp_path)
    protected = ("--tls-certificate", certificate, "--tls-key", key, "--tenants", str(tenants.path))
    async with asyncio.timeout(LIMIT_S), serving(*protected, "--drain-wait-s", "0", program=SERVER) as (process, ports):
        for _ in range(20):
            reader, writer = await asyncio.open_connection("localhost", ports["grpc_port"])
            writer.write(PLAIN)
            await reader.read()  # until the server closes the connection
            writer.transport.abort()
        process.send_signal(signal.SIGTERM)
        _, said = await process.communicate()
    assert process.returncode == 0
    assert b"andshake" not in said
    assert said.count(b"\n") < 20, said.decode()


async def test_headers_that_cannot_be_read_are_not_logged() -> None:
    async with asyncio.timeout(LIMIT_S), serving("--drain-wait-s", "0", program=SERVER) as (process, ports):
        for header in UNREADABLE:
            for _ in range(20):
                await asyncio.to_thread(answer_to, ports["grpc_port"], b"/grpc.health.v1.Health/Check", header)
        process.send_signal(signal.SIGTERM)
        _, said = await process.communicate()
    assert process.returncode == 0
    assert said.count(b"\n") < 20, said.decode()
