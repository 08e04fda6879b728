"""Connections to the server under test, at the address of the fixture `server_address`, which is defined elsewhere."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc
import pytest

from motiongen_compliance.line import TcpLine
from motiongen_compliance.target import Scene, Target, connect


@pytest.fixture
async def target(
    server_address: str, server_credentials: grpc.ChannelCredentials | None, server_token: str
) -> AsyncIterator[Target]:
    async for connected in connect(server_address, server_credentials, server_token):
        yield connected


@pytest.fixture
async def line(server_address: str) -> AsyncIterator[TcpLine]:
    """The relay through which `distant` reaches the server."""
    async with TcpLine(server_address) as line:
        yield line


@pytest.fixture
async def distant(
    server_address: str, server_credentials: grpc.ChannelCredentials | None, server_token: str, line: TcpLine
) -> AsyncIterator[Target]:
    """The server, reached over connections that a test can cut."""
    async for connected in connect(server_address, server_credentials, server_token, through=line.address):
        yield connected


@pytest.fixture
async def scene(target: Target) -> Scene:
    talk, other = await target.talk(), await target.talk()
    await talk.open(1)
    await talk.open(2)
    await other.open(1)
    return Scene(talk, other)
