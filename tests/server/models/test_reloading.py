"""Reloading models while they and others are served, and freeing what they held."""

from __future__ import annotations

import asyncio
import gc

import pytest

from motiongen.v1 import admin_pb2
from motiongen_server.engine.engine_port import ModelLost
from motiongen_server.errors import EventRefused
from motiongen_server.ops.memory import settled_objects
from motiongen_server.settings import SettingError
from tests.server.in_process import ENGINE, InProcessModel
from tests.server.models.model_shop import Stage, load, refusal, reload, unload


async def test_reload_closes_the_old_sessions_and_takes_new_ones(stage: Stage) -> None:
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


async def test_model_is_served_as_before_when_its_reload_fails(stage: Stage) -> None:
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


async def test_opens_during_a_reload_get_a_time_to_retry(stage: Stage) -> None:
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


async def test_load_goes_on_after_its_caller_has_gone(stage: Stage) -> None:
    stage.shop.go.clear()
    call = stage.admin.LoadModel(load("three"))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    call.cancel()
    stage.shop.go.set()
    await stage.until(lambda models: models[-1].model_id == "three")
    await (await stage.talk()).open(1, model_id="three")


async def test_failed_engine_leaves_others_alone_and_can_be_reloaded(stage: Stage) -> None:
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


async def test_model_that_fails_during_an_unsuccessful_reload_is_refused(stage: Stage) -> None:
    def observe(report: object) -> None:
        raise RuntimeError("the books do not fit together")

    talk = await stage.talk()
    serving = asyncio.ensure_future(stage.application.serve())
    stage.shop.broken["two"] = SettingError("cannot serve model 'two': the folder is gone")
    stage.shop.go.clear()
    reloading = asyncio.ensure_future(stage.admin.ReloadModel(reload("two")))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    stage.application.metrics.of_engine("two", ENGINE).observe = observe  # type: ignore[method-assign]
    await stage.until(lambda models: models[1].state == admin_pb2.MODEL_STATE_FAILED)
    stage.shop.go.set()
    assert (await refusal(reloading))[1] == "CANNOT_LOAD"
    await talk.ask_open(1, model_id="two")
    assert (await talk.answer(1, 1)).reason == "MODEL_FAILED"
    stage.application.ask_to_stop()
    await serving


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> dict[str, ModelLost]:
    """Failures by model; a test adds those of models that are not to be served."""
    failing: dict[str, ModelLost] = {}
    monkeypatch.setattr(InProcessModel, "failure", property(lambda model: failing.get(model.facts.model_id)))
    return failing


async def test_model_lost_on_disk_refuses_opens_until_it_is_back(stage: Stage, failing: dict[str, ModelLost]) -> None:
    talk = await stage.talk()
    failing["one"] = ModelLost("'/models/one' holds another model by now", "its weights have changed")
    stage.manager.look_after()
    status = (await stage.listed())["one"]
    assert (status.state, status.message) == (admin_pb2.MODEL_STATE_FAILED, "'/models/one' holds another model by now")
    for handle, model_id in enumerate(("one", "")):  # the default is not replaced by another model
        heard = await talk.ask_open(handle, model_id=model_id)
        assert (await talk.answer(handle, 1)).reason == "MODEL_FAILED"
        assert heard.outcomes[0].message.startswith("one is not served: its weights have changed")
    await talk.open(3, model_id="two")
    failing["one"] = ModelLost("'/models/one' cannot be loaded again", "the server could not load it again")
    stage.manager.look_after()
    with pytest.raises(EventRefused, match="could not load it again"):
        stage.manager.models.find("one")
    failing.clear()
    stage.manager.look_after()
    assert (await stage.listed())["one"].state == admin_pb2.MODEL_STATE_SERVING
    await talk.open(4, model_id="one")


async def test_model_that_recovers_during_an_unsuccessful_reload_is_served(
    stage: Stage, failing: dict[str, ModelLost]
) -> None:
    failing["one"] = ModelLost("'one' cannot be loaded again", "the server could not load it again")
    stage.manager.look_after()
    stage.shop.broken["one"] = SettingError("cannot serve model 'one': the folder is gone")
    stage.shop.go.clear()
    reloading = asyncio.ensure_future(stage.admin.ReloadModel(reload("one")))
    await stage.until(lambda models: models[-1].state == admin_pb2.MODEL_STATE_LOADING)
    failing.clear()
    stage.manager.look_after()
    with pytest.raises(EventRefused, match="one is being reloaded"):
        stage.manager.models.find("one")
    stage.shop.go.set()
    assert (await refusal(reloading))[1] == "CANNOT_LOAD"
    await (await stage.talk()).open(1, model_id="one")


async def test_unloaded_models_are_freed_despite_frozen_garbage_collection(stage: Stage) -> None:
    talk = await stage.talk()
    with settled_objects():
        await talk.open(1)
        await talk.open(2, model_id="two")
        await stage.admin.UnloadModel(unload("two", 0))
        await stage.admin.ReloadModel(reload("one", 0))
        await talk.until(lambda: talk.sessions[1].closed and talk.sessions[2].closed)
        assert [runner() is None for runner in stage.shop.made] == [True, True, False]
        assert gc.get_freeze_count() > 0


async def test_loaded_model_that_is_refused_is_freed(stage: Stage) -> None:
    assert (await refusal(stage.admin.LoadModel(load("one"))))[1] == "MODEL_LOADED"
    stage.shop.named["two"] = "another"
    assert (await refusal(stage.admin.ReloadModel(reload("two"))))[1] == "ANOTHER_MODEL"
    gc.collect()  # the exceptions refer to the models
    assert [runner() is None for runner in stage.shop.made] == [False, False, True, True]
