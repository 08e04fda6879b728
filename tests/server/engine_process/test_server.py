"""The whole server with its engine processes, and what clients notice when one of these is killed."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import sys
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import grpc.aio
import httpx
import psutil
import pytest

from motiongen.v1 import admin_pb2, admin_pb2_grpc, service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from tests.conftest import ROOT, TINY_MODEL
from tests.server.engine_process.audience import is_gone, stopped
from tests.server_process import watched
from tests.waiting import LIMIT_S, try_again, until_true

SETTINGS = ("--text-encoder", "hashed", "--profile-s", "0",
            "--port", "0", "--ops-port", "0", "--print-ports", "--drain-wait-s", "0", "--drain-grace-s", "0",
            "--admit-load", "1000", "--degrade", "false",  # however busy the machine
            "--devices")  # fmt: skip


async def start(devices: str, *more: str, models: Sequence[Path] = (TINY_MODEL,)) -> asyncio.subprocess.Process:
    named = [word for folder in models for word in ("--model", str(folder))]
    return await asyncio.create_subprocess_exec(
        sys.executable, "-m", "motiongen_server", *named, *SETTINGS, devices, *more,
        cwd=ROOT, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
    )  # fmt: skip


@asynccontextmanager
async def serving(
    devices: str, *more: str, models: Sequence[Path] = (TINY_MODEL,)
) -> AsyncIterator[tuple[asyncio.subprocess.Process, dict[str, int]]]:
    """A server that is ready, and its ports."""
    process = await start(devices, *more, models=models)
    async with watched(process) as told:
        yield process, told


def loaded_libraries(pid: int) -> str:
    """The files that a process has mapped, which include extension modules."""
    return Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")


async def test_killed_engine_ends_its_sessions_but_no_stream_and_is_replaced() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        serving("cpu:1") as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
        httpx.AsyncClient(base_url=f"http://localhost:{ports['ops_port']}") as ops,
    ):
        (engine,) = psutil.Process(process.pid).children()
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
            await try_again()
        await talk.plays_on(handle)
        assert (await ops.get("/readyz")).status_code == 200
        (engine,) = psutil.Process(process.pid).children()
        process.send_signal(signal.SIGTERM)
        assert await talk.to_the_end() is grpc.StatusCode.OK
        assert again.closed is not None
        assert again.closed.reason == session_pb2.CLOSE_REASON_DRAINED
        assert await process.wait() == 0
        assert is_gone(engine.pid)


async def test_sessions_of_the_second_engine_play_on_when_the_first_is_killed() -> None:
    async with (
        asyncio.timeout(LIMIT_S),
        serving("cpu:2") as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
        httpx.AsyncClient(base_url=f"http://localhost:{ports['ops_port']}") as ops,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        (fork_server,) = psutil.Process(process.pid).children()
        assert fork_server.num_threads() == 1, "a forked process would wait for ever for locks of other threads"
        engines = fork_server.children()
        assert len(engines) == 2
        # No load is reported meanwhile, which on a busy machine would differ between them.
        with stopped(engines[0].pid), stopped(engines[1].pid):
            heard = {handle: await talk.ask_open(handle) for handle in range(1, 5)}
            await talk.ping(1)  # by now the gateway has given each session to an engine
        await talk.until(lambda: all(each.chunks for each in heard.values()))
        assert heard[1].opened is not None
        metrics = (await ops.get("/metrics")).text
        for name in ("0", "1"):
            assert f'motiongen_engine_up{{engine="{name}"}} 1.0' in metrics
            assert f'engine="{name}",model="{heard[1].opened.model_id}"' in metrics
        os.kill(engines[0].pid, signal.SIGKILL)
        await talk.until(lambda: sum(each.closed is not None for each in heard.values()) == 2)
        for handle in [handle for handle, each in heard.items() if each.closed is None]:
            await talk.plays_on(handle)
        assert (await ops.get("/readyz")).status_code == 200
        await talk.open(5)
        await talk.plays_on(5)
        replaced = await until_true(lambda: [each for each in fork_server.children() if each not in engines])
        process.send_signal(signal.SIGTERM)
        assert await talk.to_the_end() is grpc.StatusCode.OK
        assert await process.wait() == 0
        assert all(is_gone(each.pid) for each in (fork_server, *engines, *replaced))


async def test_model_replaced_on_disk_affects_no_other_and_is_served_once_reloaded(
    tmp_path: Path,
) -> None:
    first, second = (Path(shutil.copytree(TINY_MODEL, tmp_path / name)) for name in ("first", "second"))
    async with (
        asyncio.timeout(LIMIT_S),
        serving("cpu:1", "--admin-listen", "localhost:0", models=[first, second]) as (process, ports),
        grpc.aio.insecure_channel(f"localhost:{ports['grpc_port']}") as channel,
        grpc.aio.insecure_channel(f"localhost:{ports['admin_port']}") as admin_channel,
        httpx.AsyncClient(base_url=f"http://localhost:{ports['ops_port']}") as ops,
    ):
        stub = service_pb2_grpc.MotionServiceStub(channel)
        admin = admin_pb2_grpc.MotionAdminServiceStub(admin_channel)
        talk = Talk(stub, await stub.GetCatalog(service_pb2.GetCatalogRequest()))  # type: ignore[arg-type, misc]
        await talk.hello()
        weights = bytearray((first / "denoiser.safetensors").read_bytes())
        weights[8 + int.from_bytes(weights[:8], "little")] ^= 1  # changes the first number after the header
        (first / "denoiser.safetensors").write_bytes(weights)
        (engine,) = psutil.Process(process.pid).children()
        engine.kill()
        while True:
            (one, two) = (await admin.ListModels(admin_pb2.ListModelsRequest())).models
            if one.state == admin_pb2.MODEL_STATE_FAILED:
                break
            await try_again()
        assert one.message.startswith(f"'{first}' holds another model by now")
        assert two.state == admin_pb2.MODEL_STATE_SERVING
        while (await ops.get("/readyz")).status_code != 200:
            await try_again()
        metrics = (await ops.get("/metrics")).text
        assert f'motiongen_model_engines{{model="{one.model_id}"}} 0.0' in metrics
        assert f'motiongen_model_engines{{model="{two.model_id}"}} 1.0' in metrics
        refused = await talk.ask_open(1)  # of the default model
        await talk.until(lambda: refused.outcomes)
        assert refused.outcomes[0].reason == "MODEL_FAILED"
        assert "its weights have changed" in refused.outcomes[0].message
        assert str(tmp_path) not in refused.outcomes[0].message
        await talk.open(2, model_id=two.model_id)
        await talk.plays_on(2)
        await admin.ReloadModel(admin_pb2.ReloadModelRequest(model_id=one.model_id))
        await talk.open(3)
        await talk.plays_on(3)
        await talk.plays_on(2)


async def test_gateway_loads_no_torch_and_engine_process_no_grpc() -> None:
    async with asyncio.timeout(LIMIT_S), serving("cpu:1") as (process, _):
        (engine,) = psutil.Process(process.pid).children()
        gateway_has, engine_has = loaded_libraries(process.pid), loaded_libraries(engine.pid)
    assert "/grpc/" in gateway_has
    assert "/torch/" not in gateway_has
    assert "/torch/" in engine_has
    assert "/grpc/" not in engine_has


@pytest.mark.parametrize(
    ("devices", "when"),
    [
        ("cpu:1", "at once"),
        ("cpu:1", "with torch"),
        ("cpu:2", "at once"),
        ("cpu:2", "with torch"),
        ("cpu:2", "with engines forked"),
    ],
)
async def test_sigterm_while_loading_ends_with_exit_code_0_and_no_process_left(devices: str, when: str) -> None:
    async with asyncio.timeout(LIMIT_S):
        process = await start(devices)
        below = await until_true(psutil.Process(process.pid).children)
        if when != "at once":
            await until_true(lambda: "/torch/" in loaded_libraries(below[0].pid))
        if when == "with engines forked":
            below += await until_true(below[0].children)
        for each in below:
            with suppress(psutil.NoSuchProcess):  # libraries run short system programs while they are imported
                each.send_signal(signal.SIGTERM)  # as a service manager does, to every process of the group
        process.send_signal(signal.SIGTERM)
        _, err = await process.communicate()
        assert (process.returncode, b"Traceback" in err, b"abort" in err.lower()) == (0, False, False)
        assert all(is_gone(each.pid) for each in below)
