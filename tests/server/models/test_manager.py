"""Loading and unloading models while others are served."""

from __future__ import annotations

import asyncio
import logging
import re
from typing import cast

import grpc
import grpc.aio
import pytest

from motiongen.v1 import admin_pb2, admin_pb2_grpc, service_pb2, session_pb2
from motiongen_server.app import Application
from motiongen_server.config import ServerConfig
from motiongen_server.engine.engine_port import EnginePort
from motiongen_server.engine.types import Priority
from motiongen_server.engine_process.connection import EngineLost, LoadFailed
from motiongen_server.models.manager import CannotKeep
from motiongen_server.models.registry import ModelState
from motiongen_server.settings import SettingError
from tests.contract.local import LengthEncoder
from tests.server.in_process import in_process
from tests.server.models.model_shop import LIMIT_S, Shop, Stage, load, refusal, reload, unload


async def test_sessions_of_one_stream_get_the_models_they_name(stage: Stage) -> None:
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


async def test_model_is_loaded_while_other_models_play(stage: Stage) -> None:
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
    assert re.match(r"'three' has been loading for \d+ s, .* end the engine processes", busy[2])
    stage.shop.go.set()
    status = (await loading).model
    assert (status.model_id, status.source, status.state) == ("three", "three", admin_pb2.MODEL_STATE_SERVING)
    await talk.open(3, model_id="three")
    catalog = await stage.stub.GetCatalog(service_pb2.GetCatalogRequest())
    assert [model.model_id for model in catalog.models] == ["one", "two", "three"]


@pytest.mark.parametrize(
    ("error", "told", "named"),
    [
        (
            SettingError("cannot serve model 'three': 2 tensors are missing"),
            ("FAILED_PRECONDITION", "CANNOT_LOAD"),
            "2 tensors are",
        ),
        (EngineLost("engine 1 has failed"), ("UNAVAILABLE", "ENGINE_LOST"), "engine 1 has failed; try again"),
        (LoadFailed("ZeroDivisionError: in the engine"), ("INTERNAL", "CANNOT_LOAD"), "the log says why"),
        (ZeroDivisionError("in the loader"), ("INTERNAL", "CANNOT_LOAD"), "the log says why"),
    ],
)
async def test_failed_load_gives_the_reason_and_leaves_other_models_serving(
    stage: Stage, error: Exception, told: tuple[str, str], named: str
) -> None:
    talk = await stage.talk()
    await talk.open(1)
    stage.shop.broken["three"] = error
    code, reason, message = await refusal(stage.admin.LoadModel(load("three")))
    assert (code.name, reason) == told
    assert named in message
    assert set(await stage.listed()) == {"one", "two"}
    await talk.plays_on(1)
    del stage.shop.broken["three"]
    await stage.admin.LoadModel(load("three"))
    await talk.open(2, model_id="three")


async def test_load_interrupted_by_draining_logs_no_fault(stage: Stage, caplog: pytest.LogCaptureFixture) -> None:
    stage.shop.broken["three"] = RuntimeError("the engine process was killed")
    stage.shop.go.clear()
    loading = asyncio.ensure_future(stage.manager.load("three"))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    stage.manager.drain()
    stage.shop.go.set()
    with pytest.raises(CannotKeep, match="the server is going away") as told:
        await loading
    assert (told.value.code.name, told.value.reason) == ("UNAVAILABLE", "DRAINING")
    assert [line.getMessage() for line in caplog.records if line.levelno > logging.INFO] == []


async def test_model_loaded_while_the_server_drains_takes_no_sessions(stage: Stage) -> None:
    stage.shop.go.clear()
    loading = asyncio.ensure_future(stage.manager.load("three"))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    stage.manager.drain()
    stage.shop.go.set()
    late = await loading
    refused = [kept.engine.refusal_of(Priority.NEAR, 4, is_clip=True) for kept in stage.manager.kept]
    assert [refusal.reason for refusal in refused if refusal is not None] == 3 * ["DRAINING"]
    assert late.engine.free_share == 0.0


class Leaving:
    """An engine that was told to stop, and whose last heartbeat is old."""

    failure = None
    heartbeat_at = 7.0
    num_engines = 1


async def test_heartbeat_of_a_model_being_unloaded_is_ignored(stage: Stage) -> None:
    kept = stage.manager.kept[1]
    engine, kept.state = kept.engine, ModelState.UNLOADING
    kept.engine = cast(EnginePort, Leaving())
    assert stage.manager.heartbeat_at > 7.0, "the server would report itself as not ready"
    kept.state = ModelState.SERVING
    assert stage.manager.heartbeat_at == 7.0
    kept.engine = engine


class LoadedAgain:
    """An engine whose process was lost, while the next one loads its model."""

    failure = None
    heartbeat_at = 7.0
    num_engines = 0


async def test_server_is_ready_while_one_model_is_served_and_another_is_loaded_again(stage: Stage) -> None:
    engines = [kept.engine for kept in stage.manager.kept]
    for kept in stage.manager.kept:
        kept.engine = cast(EnginePort, LoadedAgain())
        assert (stage.manager.heartbeat_at == 7.0) == (kept is stage.manager.kept[1]), "not ready only without any"
    for kept, engine in zip(stage.manager.kept, engines, strict=True):
        kept.engine = engine


async def test_second_model_of_the_same_name_is_refused(stage: Stage) -> None:
    stage.shop.named["folder"] = "two"
    told = await refusal(stage.admin.LoadModel(load("folder")))
    assert told[:2] == (grpc.StatusCode.ALREADY_EXISTS, "MODEL_LOADED")
    assert (await stage.listed())["two"].source == "two"


async def test_model_with_sessions_is_not_unloaded_without_a_grace(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1, model_id="two")
    told = await refusal(stage.admin.UnloadModel(unload("two")))
    assert told[:2] == (grpc.StatusCode.FAILED_PRECONDITION, "SESSIONS_OPEN")
    assert (await refusal(stage.admin.ReloadModel(reload("two"))))[1] == "SESSIONS_OPEN"
    await talk.plays_on(1)
    await talk.close(1)
    assert (await stage.admin.UnloadModel(unload("two"))).closed_sessions == 0
    assert set(await stage.listed()) == {"one"}


async def test_unloading_closes_the_models_sessions_and_no_others(stage: Stage) -> None:
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


async def test_during_the_grace_sessions_play_on_and_opens_are_refused(stage: Stage) -> None:
    talk = await stage.talk()
    await talk.open(1, model_id="two")
    unloading = asyncio.ensure_future(stage.admin.UnloadModel(unload("two", LIMIT_S)))
    await stage.until(lambda models: models[1].state == admin_pb2.MODEL_STATE_UNLOADING)
    await talk.plays_on(1)
    await talk.ask_open(2, model_id="two")
    assert (await talk.answer(2, 1)).reason == "UNKNOWN_MODEL"
    assert (await refusal(stage.admin.UnloadModel(unload("two", 0))))[1] == "MODEL_BUSY"
    await talk.close(1)  # the last session: the grace ends early
    assert (await unloading).closed_sessions == 0


async def test_last_model_cannot_be_unloaded(stage: Stage) -> None:
    await stage.admin.UnloadModel(unload("one"))
    told = await refusal(stage.admin.UnloadModel(unload("two")))
    assert told[:2] == (grpc.StatusCode.FAILED_PRECONDITION, "LAST_MODEL")
    opened = (await (await stage.talk()).open(1)).opened
    assert opened is not None
    assert opened.model_id == "two"  # the default, now that the first is gone


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
async def test_invalid_admin_calls_are_refused(
    stage: Stage, call: str, request_: object, code: str, reason: str
) -> None:
    told = await refusal(getattr(stage.admin, call)(request_))
    assert (told[0].name, told[1]) == (code, reason)


async def test_admin_service_is_not_served_on_the_client_port(stage: Stage) -> None:
    async with grpc.aio.insecure_channel(f"127.0.0.1:{stage.application.grpc_port}") as channel:
        stub = admin_pb2_grpc.MotionAdminServiceStub(channel)
        with pytest.raises(grpc.aio.AioRpcError) as caught:
            await stub.ListModels(admin_pb2.ListModelsRequest())
    assert caught.value.code() is grpc.StatusCode.UNIMPLEMENTED


async def test_same_model_named_twice_fails_the_start() -> None:
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
