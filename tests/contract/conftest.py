"""What the compliance suite talks to: the server at MOTIONGEN_ADDRESS, else one here and one of several processes.

    MOTIONGEN_ADDRESS=localhost:50051 python -m pytest tests/contract

Tests that must look inside a server, or stop it, use `local_server` and never touch the one at the address.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass

import grpc.aio
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_server.rpc.limits import Limits
from tests.conftest import ROOT
from tests.contract.local import NO_BUDGET, UNMETERED, LocalServer
from tests.contract.talk import Talk

ADDRESS = os.environ.get("MOTIONGEN_ADDRESS")
LIMIT_S = 60.0


@dataclass
class Target:
    """A server under test, reached over one connection."""

    stub: service_pb2_grpc.MotionServiceStub
    catalog: service_pb2.GetCatalogResponse

    def stream(self) -> Talk:
        """A new stream on which nothing has been said."""
        return Talk(self.stub, self.catalog)

    async def talk(self) -> Talk:
        """A new stream on which both sides have said hello."""
        return await self.stream().hello()


@dataclass
class Scene:
    """A session at 1 for a test to mistreat, one at 2 on the same stream, and one at 1 on another stream."""

    talk: Talk
    other: Talk

    async def others_play_on(self) -> None:
        await self.talk.plays_on(2)
        await self.other.plays_on(1)


async def connect(address: str) -> AsyncIterator[Target]:
    async with grpc.aio.insecure_channel(address) as channel:
        stub = service_pb2_grpc.MotionServiceStub(channel)
        yield Target(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]


@pytest.fixture
async def local_server() -> AsyncIterator[LocalServer]:
    """One that a test may flood: what comes is not metered."""
    async with LocalServer(Limits(stream_events_per_second=UNMETERED), service_limits=NO_BUDGET) as server:
        yield server


@pytest.fixture
async def local(local_server: LocalServer) -> AsyncIterator[Target]:
    async for target in connect(local_server.address):
        yield target


@pytest.fixture(scope="session")
def gateway(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The address of a server with two engine processes; its end is checked."""
    log = tmp_path_factory.mktemp("gateway") / "stderr.txt"
    with log.open("w", encoding="utf-8") as errors:
        command = [sys.executable, "-m", "tests.contract.gateway"]
        process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, text=True)
        assert process.stdout is not None
        with process.stdout:
            address = process.stdout.readline().strip()
            assert address, log.read_text()
            yield address
            process.send_signal(signal.SIGTERM)
            exit_code = process.wait(LIMIT_S)
    assert exit_code == 0, log.read_text()


@pytest.fixture(params=["in this process", "two engine processes"] if ADDRESS is None else ["at the address"])
async def target(request: pytest.FixtureRequest) -> AsyncIterator[Target]:
    address = request.getfixturevalue("gateway") if request.param == "two engine processes" else ADDRESS
    if address is not None:
        async for target in connect(address):
            yield target
        return
    async with LocalServer() as server:
        async for target in connect(server.address):
            yield target


@pytest.fixture
async def scene(target: Target) -> Scene:
    talk, other = await target.talk(), await target.talk()
    await talk.open(1)
    await talk.open(2)
    await other.open(1)
    return Scene(talk, other)
