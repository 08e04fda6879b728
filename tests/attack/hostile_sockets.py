"""Hostile clients without gRPC: idle connections, garbage, the operations port. See `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import socket

from tests.attack.begun import begun


async def connections(address: str) -> None:
    """Silent connections, more than the server may have descriptors."""
    host, _, port = address.rpartition(":")
    held = []
    while True:
        try:
            held.append(socket.create_connection((host, int(port)), timeout=1))
            begun()
        except OSError:
            await asyncio.sleep(0.02)
        if len(held) > 600:
            held.pop(0).close()
        await asyncio.sleep(0.001)


async def garbage(address: str) -> None:
    host, _, port = address.rpartition(":")
    while True:
        try:
            with socket.create_connection((host, int(port)), timeout=1) as connection:
                begun()
                connection.sendall(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(range(256)) * 64)
        except OSError:
            pass
        await asyncio.sleep(0.002)


async def idle_connections(address: str) -> None:
    """Connections with a request that is never completed."""
    host, _, port = address.rpartition(":")
    held = []
    while True:
        try:
            held.append(socket.create_connection((host, int(port)), timeout=1))
            begun()
            held[-1].sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\n")
        except OSError:
            await asyncio.sleep(0.02)
        if len(held) > 400:
            held.pop(0).close()
        await asyncio.sleep(0.002)


async def unread_metrics(address: str) -> None:
    """Metrics, requested again and again on connections that are never read."""
    host, _, port = address.rpartition(":")
    held = []
    while True:
        try:
            connection = socket.create_connection((host, int(port)), timeout=1)
            begun()
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            connection.sendall(b"GET /metrics HTTP/1.1\r\nHost: x\r\n\r\n" * 50)
            held.append(connection)
        except OSError:
            await asyncio.sleep(0.02)
        if len(held) > 100:
            held.pop(0).close()
        await asyncio.sleep(0.02)
