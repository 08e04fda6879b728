"""The whole server with its engine in a process of its own, and what clients notice when that process is killed."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from collections.abc import AsyncIterator

import grpc.aio
import httpx
import psutil
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from tests.conftest import ROOT, TINY_MODEL
from tests.contract.talk import Talk
from tests.server.engine_process.audience import is_gone

LIMIT_S = 90.0
SETTINGS = ("--engine-process", "--model", str(TINY_MODEL), "--text-encoder", "hashed", "--threads", "1",
            "--profile-s", "0", "--port", "0", "--ops-port", "0", "--print-ports",
            "--drain-wait-s", "0", "--drain-grace-s", "0")  # fmt: skip


@pytest.fixture
async def server() -> AsyncIterator[tuple[asyncio.subprocess.Process, dict[str, int]]]:
    """A server that is ready, and its ports."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "motiongen_server", *SETTINGS, cwd=ROOT, stdout=asyncio.subprocess.PIPE, stderr=None
    )
    assert process.stdout is not None
    yield process, json.loads(await process.stdout.readline())
    if process.returncode is None:
        process.kill()
    await process.wait()


async def test_a_killed_engine_ends_sessions_not_streams_and_service_goes_on(
    server: tuple[asyncio.subprocess.Process, dict[str, int]],
) -> None:
    process, ports = server
    (engine,) = psutil.Process(process.pid).children()
    async with (
        asyncio.timeout(LIMIT_S),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
        httpx.AsyncClient(base_url=f"http://localhost:{ports['ops_port']}") as ops,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        heard = await talk.open(1)
        await talk.plays_on(1)
        os.kill(engine.pid, signal.SIGKILL)
        await talk.until(lambda: heard.closed is not None)
        assert heard.closed is not None
        assert heard.closed.reason == session_pb2.CLOSE_REASON_ENGINE_FAULT
        assert (await ops.get("/livez")).status_code == 200
        refused = await talk.ask_open(2)
        await talk.until(lambda: refused.outcomes)
        assert refused.outcomes[0].reason == "ENGINE_RESTARTING"
        assert refused.outcomes[0].retry_after.ToMilliseconds() > 0
        handle = 3
        while True:
            again = await talk.ask_open(handle)
            await talk.until(lambda heard=again: heard.chunks or heard.outcomes)
            if again.chunks:
                break
            handle += 1
            await asyncio.sleep(0.1)
        await talk.plays_on(handle)
        assert (await ops.get("/readyz")).status_code == 200
        (engine,) = psutil.Process(process.pid).children()
        process.send_signal(signal.SIGTERM)
        assert await talk.to_the_end() is grpc.StatusCode.OK
        assert again.closed is not None
        assert again.closed.reason == session_pb2.CLOSE_REASON_DRAINED
        assert await process.wait() == 0
        assert is_gone(engine.pid)
