"""What the tests talk to: the server at `server_address`, which who runs them names."""

from __future__ import annotations

from collections.abc import AsyncIterator

import grpc
import pytest

from motiongen_compliance.target import Scene, Target, connect


@pytest.fixture
async def target(
    server_address: str, server_credentials: grpc.ChannelCredentials | None, server_token: str
) -> AsyncIterator[Target]:
    async for connected in connect(server_address, server_credentials, server_token):
        yield connected


@pytest.fixture
async def scene(target: Target) -> Scene:
    talk, other = await target.talk(), await target.talk()
    await talk.open(1)
    await talk.open(2)
    await other.open(1)
    return Scene(talk, other)
