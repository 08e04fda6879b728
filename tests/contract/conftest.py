"""A server whose internals the tests of this folder can see. Tests for any server are in compliance/."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from motiongen_compliance.target import Target, connect
from motiongen_server.rpc.limits import Limits
from tests.contract.local import NO_BUDGET, UNMETERED, LocalServer


@pytest.fixture
async def local_server() -> AsyncIterator[LocalServer]:
    """A server without rate limits, which a test may flood."""
    async with LocalServer(Limits(stream_events_per_second=UNMETERED), service_limits=NO_BUDGET) as server:
        yield server


@pytest.fixture
async def local(local_server: LocalServer) -> AsyncIterator[Target]:
    async for target in connect(local_server.address):
        yield target
