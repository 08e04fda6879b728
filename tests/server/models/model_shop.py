"""An application with fake models that are loaded, unloaded and reloaded while tests talk to it."""

from __future__ import annotations

import threading
import weakref
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace

import grpc
import grpc.aio
import pytest
from google.protobuf.duration_pb2 import Duration
from google.rpc import error_details_pb2
from grpc_status import rpc_status

from motiongen.v1 import admin_pb2, admin_pb2_grpc, service_pb2, service_pb2_grpc
from motiongen_compliance.talk import Talk
from motiongen_server.app import Application
from motiongen_server.config import ServerConfig
from motiongen_server.models.manager import ModelManager
from tests.contract.local import LengthEncoder
from tests.server.application import config
from tests.server.engine.fakes import FACTS, FakeRunner, RealTime
from tests.server.in_process import in_process
from tests.waiting import LIMIT_S


class Shop:
    """Loads fake models by their names. A test can delay a load, or make it fail."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.go.set()
        self.asked: list[str] = []
        self.broken: dict[str, Exception] = {}
        self.named: dict[str, str] = {}
        self.made: list[weakref.ref[FakeRunner]] = []

    def __call__(self, config: ServerConfig) -> FakeRunner:
        self.asked.append(config.model)
        assert self.go.wait(LIMIT_S)
        if config.model in self.broken:
            raise self.broken[config.model]
        runner = FakeRunner(RealTime())
        self.made.append(weakref.ref(runner))
        model_id = self.named.get(config.model, config.model)
        runner.facts = replace(FACTS, model_id=model_id, rig=replace(FACTS.rig, rig_id=f"rig-{model_id}"))
        return runner


class Stage:
    """An application with the models `one` and `two`, and stubs of both services."""

    def __init__(self, application: Application, shop: Shop) -> None:
        self.shop = shop
        self.application = application
        self._channel = grpc.aio.insecure_channel(f"127.0.0.1:{application.grpc_port}")
        self._admin_channel = grpc.aio.insecure_channel(f"127.0.0.1:{application.admin_port}")
        self.stub = service_pb2_grpc.MotionServiceStub(self._channel)  # type: ignore[no-untyped-call]
        self.admin = admin_pb2_grpc.MotionAdminServiceStub(self._admin_channel)  # type: ignore[no-untyped-call]

    @property
    def manager(self) -> ModelManager:
        """The application's model manager."""
        return self.application._manager

    async def close(self) -> None:
        await self._channel.close(None)
        await self._admin_channel.close(None)

    async def talk(self) -> Talk:
        catalog = await self.stub.GetCatalog(service_pb2.GetCatalogRequest())
        return await Talk(self.stub, catalog).hello()

    async def listed(self) -> dict[str, admin_pb2.ModelStatus]:
        response = await self.admin.ListModels(admin_pb2.ListModelsRequest())
        return {model.model_id: model for model in response.models}

    async def until(self, holds: Callable[[Sequence[admin_pb2.ModelStatus]], bool]) -> None:
        """Request the list of models until a condition holds for it."""
        while not holds((await self.admin.ListModels(admin_pb2.ListModelsRequest())).models):
            pass


@asynccontextmanager
async def running(shop: Shop, model: str = "one,two") -> AsyncIterator[Stage]:
    application = Application(config(model=model, admin_listen="127.0.0.1:0"), in_process(shop, LengthEncoder()))
    await application.start()
    stage = Stage(application, shop)
    try:
        yield stage
    finally:
        shop.go.set()
        await stage.close()
        await application.drain()


def grace(seconds: float) -> Duration:
    return Duration(seconds=int(seconds), nanos=round(seconds % 1 * 1e9))


async def refusal(call: object) -> tuple[grpc.StatusCode, str, str]:
    """Status code, reason and message with which a call fails."""
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await call  # type: ignore[misc]
    status = rpc_status.from_call(caught.value)
    info = error_details_pb2.ErrorInfo()
    status.details[0].Unpack(info)
    return caught.value.code(), info.reason, caught.value.details() or ""


def load(source: str) -> admin_pb2.LoadModelRequest:
    return admin_pb2.LoadModelRequest(source=source)


def unload(model_id: str, grace_s: float | None = None) -> admin_pb2.UnloadModelRequest:
    return admin_pb2.UnloadModelRequest(model_id=model_id, grace=None if grace_s is None else grace(grace_s))


def reload(model_id: str, grace_s: float | None = None) -> admin_pb2.ReloadModelRequest:
    return admin_pb2.ReloadModelRequest(model_id=model_id, grace=None if grace_s is None else grace(grace_s))
