"""Attacks that do not take place are noticed: hostile clients must reach the server and run until they are killed."""

from __future__ import annotations

import asyncio
import os
import socket
from pathlib import Path

import psutil
import pytest

from tests.attack.attack import Attack, hostile
from tests.attack.hostile_clients import HostileClientEnded
from tests.attack.server import Attacked


def attacked_at(port: int) -> Attacked:
    return Attacked(psutil.Process(), f"127.0.0.1:{port}", 0, Path("nowhere"))


async def test_client_that_fails_to_start_raises_an_error() -> None:
    with (
        pytest.raises(HostileClientEnded, match=r"'no_such_kind' ended with 1:[^$]*KeyError"),
        hostile(Attack("", "no_such_kind"), attacked_at(1)) as clients,
    ):
        await clients.begun()


async def kill_it_once_it_has_begun(port: int) -> None:
    with hostile(Attack("", "garbage"), attacked_at(port)) as clients:
        await clients.begun()
        (client,) = [each for each in psutil.Process().children() if "garbage" in each.cmdline()]
        client.kill()
        await asyncio.to_thread(os.waitid, os.P_PID, client.pid, os.WEXITED | os.WNOWAIT)


async def test_client_that_ends_early_raises_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener, pytest.raises(HostileClientEnded, match="ended with -9"):
        await kill_it_once_it_has_begun(listener.getsockname()[1])


async def test_begun_returns_once_all_clients_have_reached_the_server() -> None:
    def accept(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # Connections of the first client that nobody accepts would keep a second that starts late out for ever.
        writer.close()

    async with await asyncio.start_server(accept, "127.0.0.1", 0) as server:
        with hostile(Attack("", "garbage", clients=2), attacked_at(server.sockets[0].getsockname()[1])) as clients:
            await clients.begun()


async def test_without_an_attack_no_client_is_waited_for() -> None:
    with hostile(Attack("", ""), attacked_at(1)) as clients:
        await clients.begun()
