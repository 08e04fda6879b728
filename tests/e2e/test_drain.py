"""How a server process ends: drained by SIGTERM while a stream is open, or at the start for a wrong setting."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc
import grpc.aio
import httpx
import psutil
import pytest

from motiongen.v1 import service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from tests.attack.endings import catches_sigterm
from tests.conftest import ROOT, TINY_MODEL
from tests.scale.replicas import NULL_SERVER, SERVER
from tests.server_process import watched
from tests.waiting import LIMIT_S, until_true

ANY_LOAD = ("--admit-load", "1000", "--degrade", "false")  # however busy the machine
MODEL = ["--model", str(TINY_MODEL), "--text-encoder", "hashed", "--devices", "cpu:1"]
FREE_PORTS = ["--port", "0", "--ops-port", "0", "--print-ports"]


async def start(*arguments: str, program: str = SERVER, **environment: str) -> asyncio.subprocess.Process:
    return await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        program,
        *arguments,
        cwd=ROOT,
        env={**os.environ, **environment},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
    )


@asynccontextmanager
async def serving(
    *arguments: str, program: str = NULL_SERVER
) -> AsyncIterator[tuple[asyncio.subprocess.Process, dict[str, int]]]:
    """A server that is ready, and its ports. It is ended if the test has not done so."""
    process = await start(*MODEL, *FREE_PORTS, *ANY_LOAD, *arguments, program=program)
    async with watched(process) as told:
        yield process, told


async def test_sigterm_with_an_open_stream_sends_goodbye_and_exits_with_0() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        serving("--drain-wait-s", "0", "--drain-grace-s", "3600", program=SERVER) as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
        httpx.AsyncClient(base_url=f"http://localhost:{ports['ops_port']}") as ops,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        await talk.open(1)
        assert (await ops.get("/readyz")).status_code == 200
        process.send_signal(signal.SIGTERM)
        await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
        assert (await ops.get("/readyz")).status_code == 503
        assert (await ops.get("/livez")).status_code == 200
        await talk.plays_on(1)
        await talk.close(1)
        await talk.call.done_writing()
        assert await talk.to_the_end() is grpc.StatusCode.OK
        assert await process.wait() == 0, "it must not wait for the end of the grace"


async def test_second_sigterm_ends_the_grace_and_exits_with_0() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        serving("--drain-wait-s", "0", "--drain-grace-s", "3600") as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        await talk.open(1)
        process.send_signal(signal.SIGTERM)
        await talk.until(lambda: talk.responses[-1].HasField("goodbye"))
        process.send_signal(signal.SIGTERM)
        assert await process.wait() == 0


@pytest.mark.parametrize("moment", ["at the very start", "while it loads"])
async def test_sigterm_before_the_server_is_ready_exits_with_0(moment: str) -> None:
    async with asyncio.timeout(LIMIT_S):
        process = await start(*MODEL, *FREE_PORTS)
        try:
            await until_true(lambda: catches_sigterm(process.pid))
            if moment == "while it loads":
                await until_true(psutil.Process(process.pid).children)  # its engine process, which is loading
            process.send_signal(signal.SIGTERM)
            _, err = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
    assert process.returncode == 0, err.decode()
    assert b"Traceback" not in err


async def test_ops_client_that_does_not_read_does_not_delay_the_end() -> None:
    async with asyncio.timeout(LIMIT_S), serving("--drain-wait-s", "0", "--drain-grace-s", "0") as (process, ports):
        reader, writer = await asyncio.open_connection("localhost", ports["ops_port"], limit=1)
        idle = await asyncio.open_connection("localhost", ports["ops_port"])
        for _ in range(200):  # more than the buffers between the two hold
            writer.write(b"GET /metrics HTTP/1.1\r\nHost: here\r\n\r\n")
        await reader.readexactly(1)
        process.send_signal(signal.SIGTERM)
        assert await process.wait() == 0
        for each in (writer, idle[1]):
            each.transport.abort()


async def test_sessions_left_after_the_grace_are_closed_as_drained() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        serving("--drain-wait-s", "0", "--drain-grace-s", "0.1") as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        heard = await talk.open(1)
        process.send_signal(signal.SIGTERM)
        assert await talk.to_the_end() is grpc.StatusCode.OK
        assert heard.closed is not None
        assert heard.closed.reason == session_pb2.CLOSE_REASON_DRAINED
        assert any(response.HasField("goodbye") for response in talk.responses)
        assert await process.wait() == 0


@pytest.mark.parametrize(
    ("arguments", "environment", "named"),
    [
        (["--port", "99999"], {}, "port is 99999; it must be from 0 to 65535"),
        ([], {"MOTIONGEN_DENOISE_STEPS": "few"}, "denoise_steps is 'few'"),
        ([], {"MOTIONGEN_PORTS": "1"}, "MOTIONGEN_PORTS"),
        ([*MODEL, *FREE_PORTS, "--model", "no-such-model"], {}, "no-such-model"),
        ([*MODEL, *FREE_PORTS, "--lookahead-frames", "20"], {}, "lookahead_frames is 20"),
    ],
    ids=["range", "kind", "name", "model", "fit"],
)
async def test_invalid_setting_is_reported_in_one_line(
    arguments: list[str], environment: dict[str, str], named: str
) -> None:
    async with asyncio.timeout(LIMIT_S):
        process = await start(*arguments, **environment)
        out, err = await process.communicate()
    assert process.returncode == 2
    assert out == b""
    (line,) = err.decode().splitlines()
    assert line.startswith("error: ")
    assert named in line


@pytest.mark.parametrize("flag", ["--port", "--ops-port"])
async def test_port_in_use_is_reported_in_one_line(flag: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        async with asyncio.timeout(LIMIT_S):
            process = await start(*MODEL, *FREE_PORTS, flag, str(port))
            _, err = await process.communicate()
    assert process.returncode == 2, err.decode()
    (line,) = [line for line in err.decode().splitlines() if line.startswith("error: ")]
    assert str(port) in line
    assert "Traceback" not in err.decode()
