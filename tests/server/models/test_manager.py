"""Loading, unloading and reloading models while others are served, with fake models in one application over gRPC."""

from __future__ import annotations

import asyncio
import gc
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

from motiongen.v1 import admin_pb2, admin_pb2_grpc, service_pb2, service_pb2_grpc, session_pb2
from motiongen_compliance.talk import Talk
from motiongen_server.app import Application
from motiongen_server.config import ServerConfig
from motiongen_server.ops.memory import settled_objects
from motiongen_server.settings import SettingError
from tests.contract.local import LengthEncoder, RealTime
from tests.server.engine.fakes import FACTS, FakeRunner
from tests.server.in_process import ENGINE, in_process

LIMIT_S = 20.0


class Shop:
    """Loads fake models by their names. A test may hold a load up, or have it fail."""

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
        """Ask for the list until something holds of it."""
        while not holds((await self.admin.ListModels(admin_pb2.ListModelsRequest())).models):
            pass


@pytest.fixture
async def stage() -> AsyncIterator[Stage]:
    shop = Shop()
    async with asyncio.timeout(2 * LIMIT_S), running(shop) as stage:
        yield stage


@asynccontextmanager
async def running(shop: Shop, model: str = "one,two") -> AsyncIterator[Stage]:
    settings = ServerConfig(
        port=0, ops_port=0, drain_wait_s=0, drain_grace_s=0, profile_s=0, model=model, admin_listen="127.0.0.1:0"
    )
    application = Application(settings, in_process(shop, LengthEncoder()))
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
    """Code, reason and message with which a call ends."""
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


async def test_sessions_get_the_model_they_name_on_one_stream(stage: Stage) -> None:
    talk = await stage.talk()
    opened = [(await talk.open(handle, model_id=model)).opened for handle, model in enumerate(("", "two", "one"))]
    assert [each.model_id for each in opened if each] == ["one", "two", "one"]
    assert [each.rig_id for each in opened if each] == ["rig-one", "rig-two", "rig-one"]
    for handle in range(3):
        await talk.plays_on(handle)
    assert {name: model.sessions for name, model in (await stage.listed()).items()} == {"one": 2, "two": 1}
    heard = await talk.ask_open(7, model_id="three")
    assert (await talk.answer(7, 1)).reason == "UNKNOWN_MODEL"
    assert (heard.outcomes[0].field, heard.outcomes[0].allowed) == ("open.model_id", "one, two")


async def test_a_model_is_loaded_while_others_play(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1)
    stage.shop.go.clear()
    loading = asyncio.ensure_future(stage.admin.LoadModel(load("three")))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    await talk.plays_on(1)
    await talk.ask_open(2, model_id="three")
    assert (await talk.answer(2, 1)).reason == "UNKNOWN_MODEL"
    busy = await refusal(stage.admin.LoadModel(load("four")))
    assert busy[:2] == (grpc.StatusCode.UNAVAILABLE, "LOADING")
    stage.shop.go.set()
    status = (await loading).model
    assert (status.model_id, status.source, status.state) == ("three", "three", admin_pb2.MODEL_STATE_SERVING)
    await talk.open(3, model_id="three")
    catalog = await stage.stub.GetCatalog(service_pb2.GetCatalogRequest())
    assert [model.model_id for model in catalog.models] == ["one", "two", "three"]


@pytest.mark.parametrize(
    ("error", "code", "named"),
    [
        (SettingError("cannot serve model 'three': 2 tensors are missing"), "FAILED_PRECONDITION", "2 tensors are"),
        (ZeroDivisionError("in the loader"), "INTERNAL", "the log says why"),
    ],
)
async def test_a_load_that_fails_is_told_and_leaves_the_others_serving(
    stage: Stage, error: Exception, code: str, named: str
) -> None:
    talk = await stage.talk()
    await talk.open(1)
    stage.shop.broken["three"] = error
    told = await refusal(stage.admin.LoadModel(load("three")))
    assert (told[0].name, told[1]) == (code, "CANNOT_LOAD")
    assert named in told[2]
    assert set(await stage.listed()) == {"one", "two"}
    await talk.plays_on(1)
    del stage.shop.broken["three"]
    await stage.admin.LoadModel(load("three"))
    await talk.open(2, model_id="three")


async def test_two_models_of_one_name_are_not_held(stage: Stage) -> None:
    stage.shop.named["folder"] = "two"
    told = await refusal(stage.admin.LoadModel(load("folder")))
    assert told[:2] == (grpc.StatusCode.ALREADY_EXISTS, "MODEL_LOADED")
    assert (await stage.listed())["two"].source == "two"


async def test_a_model_with_sessions_is_not_unloaded_without_a_grace(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1, model_id="two")
    told = await refusal(stage.admin.UnloadModel(unload("two")))
    assert told[:2] == (grpc.StatusCode.FAILED_PRECONDITION, "SESSIONS_OPEN")
    assert (await refusal(stage.admin.ReloadModel(reload("two"))))[1] == "SESSIONS_OPEN"
    await talk.plays_on(1)
    await talk.close(1)
    assert (await stage.admin.UnloadModel(unload("two"))).closed_sessions == 0
    assert set(await stage.listed()) == {"one"}


async def test_sessions_of_an_unloaded_model_are_closed_and_those_of_others_go_on(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1)
    await talk.open(2, model_id="two")
    assert (await stage.admin.UnloadModel(unload("two", 0))).closed_sessions == 1
    await talk.until(lambda: talk.sessions[2].closed)
    closed = talk.sessions[2].closed
    assert closed is not None
    assert (closed.reason, closed.code) == (session_pb2.CLOSE_REASON_MODEL_UNLOADED, 0)
    await talk.plays_on(1)
    await talk.ask_open(3, model_id="two")
    assert (await talk.answer(3, 1)).reason == "UNKNOWN_MODEL"
    await stage.admin.LoadModel(load("two"))
    await talk.open(4, model_id="two")


async def test_within_the_grace_sessions_play_on_and_none_is_opened(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1, model_id="two")
    unloading = asyncio.ensure_future(stage.admin.UnloadModel(unload("two", LIMIT_S)))
    await stage.until(lambda models: models[1].state == admin_pb2.MODEL_STATE_UNLOADING)
    await talk.plays_on(1)
    await talk.ask_open(2, model_id="two")
    assert (await talk.answer(2, 1)).reason == "UNKNOWN_MODEL"
    assert (await refusal(stage.admin.UnloadModel(unload("two", 0))))[1] == "MODEL_BUSY"
    await talk.close(1)  # the last one: nothing is waited for any longer
    assert (await unloading).closed_sessions == 0


async def test_the_last_model_stays(stage: Stage) -> None:
    await stage.admin.UnloadModel(unload("one"))
    told = await refusal(stage.admin.UnloadModel(unload("two")))
    assert told[:2] == (grpc.StatusCode.FAILED_PRECONDITION, "LAST_MODEL")
    opened = (await (await stage.talk()).open(1)).opened
    assert opened is not None
    assert opened.model_id == "two"  # the default, now that the first is gone


async def test_a_reloaded_model_takes_new_sessions_and_lets_the_old_ones_end(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1)
    await talk.open(2, model_id="two")
    response = await stage.admin.ReloadModel(reload("one", 0))
    assert (response.closed_sessions, response.model.model_id) == (1, "one")
    assert stage.shop.asked == ["one", "two", "one"]
    await talk.until(lambda: talk.sessions[1].closed)
    await talk.plays_on(2)
    await talk.open(3)
    await talk.plays_on(3)
    listed = await stage.admin.ListModels(admin_pb2.ListModelsRequest())
    assert [(model.model_id, model.sessions) for model in listed.models] == [("one", 1), ("two", 1)]


async def test_a_model_that_cannot_be_loaded_again_is_served_as_before(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1)
    stage.shop.broken["one"] = SettingError("cannot serve model 'one': the folder is gone")
    assert "the folder is gone" in (await refusal(stage.admin.ReloadModel(reload("one", 0))))[2]
    await talk.plays_on(1)
    await talk.close(1)
    assert "the folder is gone" in (await refusal(stage.admin.ReloadModel(reload("one"))))[2]
    stage.shop.broken.clear()
    stage.shop.named["one"] = "another"
    assert (await refusal(stage.admin.ReloadModel(reload("one"))))[1] == "ANOTHER_MODEL"
    await talk.open(2)


async def test_while_a_model_without_sessions_is_reloaded_opens_are_told_to_come_back(stage: Stage) -> None:
    talk = await stage.talk()
    stage.shop.go.clear()
    reloading = asyncio.ensure_future(stage.admin.ReloadModel(reload("one")))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    await talk.ask_open(1)
    outcome = await talk.answer(1, 1)
    assert (outcome.reason, outcome.retry_after.seconds) == ("MODEL_RELOADING", 2)
    assert (await refusal(stage.admin.UnloadModel(unload("one"))))[1] == "MODEL_BUSY"
    stage.shop.go.set()
    await reloading
    await talk.open(2)


async def test_what_was_begun_goes_on_when_the_caller_has_gone(stage: Stage) -> None:
    stage.shop.go.clear()
    call = stage.admin.LoadModel(load("three"))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    call.cancel()
    stage.shop.go.set()
    await stage.until(lambda models: models[-1].model_id == "three")
    await (await stage.talk()).open(1, model_id="three")


async def test_an_engine_that_fails_takes_no_other_with_it_and_can_be_reloaded(stage: Stage) -> None:
    def observe(report: object) -> None:
        raise RuntimeError("the books do not fit together")

    talk = await stage.talk()
    await talk.open(1)
    serving = asyncio.ensure_future(stage.application.serve())
    metrics = stage.application.metrics.of_engine("two", ENGINE)
    sound = metrics.observe
    metrics.observe = observe  # type: ignore[method-assign]
    await stage.until(lambda models: models[1].state == admin_pb2.MODEL_STATE_FAILED)
    assert "the books do not fit" in (await stage.listed())["two"].message
    await talk.ask_open(2, model_id="two")
    assert (await talk.answer(2, 1)).reason == "MODEL_FAILED"
    await talk.plays_on(1)
    assert not serving.done()
    metrics.observe = sound  # type: ignore[method-assign]
    await stage.admin.ReloadModel(reload("two"))
    await talk.open(3, model_id="two")
    stage.application.ask_to_stop()
    await serving


@pytest.mark.parametrize(
    ("call", "request_", "code", "reason"),
    [
        ("LoadModel", load(""), "INVALID_ARGUMENT", "FIELD_EMPTY"),
        ("UnloadModel", unload(""), "INVALID_ARGUMENT", "FIELD_EMPTY"),
        ("UnloadModel", unload("three", 0), "NOT_FOUND", "UNKNOWN_MODEL"),
        ("ReloadModel", reload("three"), "NOT_FOUND", "UNKNOWN_MODEL"),
        ("UnloadModel", unload("two", 3601), "INVALID_ARGUMENT", "GRACE_OUT_OF_RANGE"),
        ("ReloadModel", reload("two", -1), "INVALID_ARGUMENT", "GRACE_OUT_OF_RANGE"),
    ],
)
async def test_calls_that_make_no_sense(stage: Stage, call: str, request_: object, code: str, reason: str) -> None:
    told = await refusal(getattr(stage.admin, call)(request_))
    assert (told[0].name, told[1]) == (code, reason)


async def test_the_admin_service_is_not_on_the_port_of_clients(stage: Stage) -> None:
    async with grpc.aio.insecure_channel(f"127.0.0.1:{stage.application.grpc_port}") as channel:
        stub = admin_pb2_grpc.MotionAdminServiceStub(channel)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stub.ListModels(admin_pb2.ListModelsRequest())
    assert caught.value.code() is grpc.StatusCode.UNIMPLEMENTED


async def test_one_model_named_twice_is_a_wrong_setting() -> None:
    shop = Shop()
    shop.named["folder"] = "one"
    application = Application(
        ServerConfig(port=0, ops_port=0, profile_s=0, model="one,folder"),
        in_process(shop, LengthEncoder()),
    )
    async with asyncio.timeout(LIMIT_S):
        with pytest.raises(SettingError, match="two of these are one"):
            await application.start()
        await application.stop_ops()


async def test_what_is_unloaded_is_freed_though_what_is_loaded_is_left_out_of_collection(stage: Stage) -> None:
    talk = await stage.talk()
    with settled_objects():
        await talk.open(1)
        await talk.open(2, model_id="two")
        await stage.admin.UnloadModel(unload("two", 0))
        await stage.admin.ReloadModel(reload("one", 0))
        await talk.until(lambda: talk.sessions[1].closed and talk.sessions[2].closed)
        assert [runner() is None for runner in stage.shop.made] == [True, True, False]
        assert gc.get_freeze_count() > 0
