"""An engine process keeps nothing of a model that it was told to unload."""

from __future__ import annotations

import weakref

import pytest

from motiongen_server.config import ServerConfig
from motiongen_server.devices import EngineDevice
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.types import CloseReason
from motiongen_server.engine_process.child import FreshChild
from motiongen_server.engine_process.messages import (
    Begin,
    EncoderReady,
    Load,
    LoadEncoder,
    Ready,
    Stop,
    Unload,
    Unloaded,
)
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.engine_process.process import EngineProcess
from motiongen_server.engine_process.slot import Built
from motiongen_server.ops.memory import settled_objects
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from motiongen_server.settings import SettingError
from tests.server.engine.fakes import FACTS, FakeRunner, RealTime
from tests.server.engine_process.test_host import Process

READY = Ready(1, FACTS, "CC0-1.0", NOTHING_CLAIMED)


def restarting() -> tuple[EngineProcess, ModelLink]:
    """An engine that was lost, and whose next process is about to be told to load its model."""

    def start(*_: object) -> FreshChild:
        raise OSError("nothing is started here")

    process = EngineProcess(
        "0", EngineDevice("cpu", 0, 1), Begin(ServerConfig(), "cpu", 1, 1), lambda outputs: None, start
    )
    link = process.load_model(1, "model")
    link.take_ready(READY)
    link.lose(CloseReason.ENGINE_FAULT, "it was killed")
    process._control.begin()
    return process, link


def test_model_given_up_while_loading_again_is_unloaded_once_loaded() -> None:
    process, link = restarting()
    assert process._control.take() == (Load(1, "model"),)
    process.unload_model(link)
    assert link.ended.is_set()
    process._take(READY)
    assert process._control.take() == (Unload(1),)
    process._take(Unloaded(1))
    assert process._control.take() == ()


def test_model_given_up_before_the_next_process_is_told_is_not_loaded() -> None:
    process, link = restarting()
    process.unload_model(link)
    assert process._control.take() == ()


def test_model_given_up_at_the_moment_it_is_loaded_is_unloaded(monkeypatch: pytest.MonkeyPatch) -> None:
    process, link = restarting()
    process._control.take()
    take_ready = link.take_ready

    def given_up_first(message: Ready) -> bool:
        process.unload_model(link)
        return take_ready(message)

    monkeypatch.setattr(link, "take_ready", given_up_first)
    process._take(READY)
    assert process._control.take() == (Unload(1),)


class RealEngines(Process):
    """Loads real engines, each with a runner that stands for a model's weights."""

    def __init__(self) -> None:
        self.runners: list[weakref.ref[FakeRunner]] = []
        super().__init__()

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        runner = FakeRunner(RealTime())
        self.runners.append(weakref.ref(runner))
        if source == "unsound":
            runner.itself = runner  # type: ignore[attr-defined]  # models have such reference cycles
            raise SettingError("its capabilities are no mapping")
        engine = Engine(runner, RealTime(), deliver, EngineConfig(), observe=observe, inbox=inbox)
        return Built(engine, runner.facts, "CC0-1.0")


@pytest.mark.parametrize("unloaded", [1, 2])
def test_unloaded_model_is_freed_although_loaded_objects_are_frozen(unloaded: int) -> None:
    with settled_objects():
        process = RealEngines()
        for slot in (1, 2):
            process.load(slot)
        process.tell(Unload(unloaded))
        assert process.hear_of(Unloaded) == Unloaded(unloaded)
        process.tell(LoadEncoder(2))  # this is loaded only after the unloading
        process.hear_of(EncoderReady)
        assert [runner() is None for runner in process.runners] == [unloaded == 1, unloaded == 2]
        process.tell(Stop())
        while process.thread.is_alive():
            process.hear(10)
        process.end.close()
        process.gateway.close()


def test_refused_model_is_freed_completely() -> None:
    """It may be tried again and again beside sessions that never end, so freeing must not wait for an idle moment."""
    with settled_objects():
        process = RealEngines()
        process.load(1)
        process.tell(Load(2, "unsound"))
        assert process.hear_of(Unloaded) == Unloaded(2, "its capabilities are no mapping", is_setting=True)
        assert [runner() is None for runner in process.runners] == [False, True]
        process.tell(Stop())
        while process.thread.is_alive():
            process.hear(10)
        process.end.close()
        process.gateway.close()
