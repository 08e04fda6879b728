"""The application with a fake model, in the test's process."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import httpx
from grpc_health.v1 import health_pb2

from motiongen_server.app import Application
from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Runner
from tests.contract.local import LengthEncoder
from tests.server.engine.fakes import FakeRunner, RealTime
from tests.server.in_process import in_process
from tests.waiting import LIMIT_S

SERVING, NOT_SERVING = health_pb2.HealthCheckResponse.SERVING, health_pb2.HealthCheckResponse.NOT_SERVING


def config(**settings: object) -> ServerConfig:
    defaults: dict[str, object] = {"port": 0, "ops_port": 0, "drain_wait_s": 0, "drain_grace_s": 0, "profile_s": 0}
    defaults |= {"admit_load": 1000.0, "degrade": False}  # so that a busy machine changes nothing
    return ServerConfig(**{**defaults, **settings})  # type: ignore[arg-type]


def load(_: ServerConfig) -> FakeRunner:
    return FakeRunner(RealTime())


class SlowLoad:
    """Loads the fake model once `may_end` is set. begun: the load has begun."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self.begun = asyncio.Event()
        self.may_end = threading.Event()

    def __call__(self, settings: ServerConfig) -> FakeRunner:
        self._loop.call_soon_threadsafe(self.begun.set)
        assert self.may_end.wait(LIMIT_S)
        return load(settings)


def application_of(settings: ServerConfig, load: Callable[[ServerConfig], Runner] = load) -> Application:
    return Application(settings, in_process(load, LengthEncoder()))


@asynccontextmanager
async def running(settings: ServerConfig) -> AsyncIterator[Application]:
    """A started application, drained at the end."""
    async with asyncio.timeout(LIMIT_S):
        application = application_of(settings)
        await application.start()
        try:
            yield application
        finally:
            await application.drain()


async def get(application: Application, path: str) -> httpx.Response:
    async with httpx.AsyncClient(base_url=f"http://127.0.0.1:{application.ops_port}") as client:
        return await client.get(path)
