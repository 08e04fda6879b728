"""What an engine process keeps of a model that it was told to unload: nothing."""

from __future__ import annotations

import weakref

import pytest

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine_process.messages import EncoderReady, LoadEncoder, Stop, Unload, Unloaded
from motiongen_server.engine_process.slot import Built
from motiongen_server.ops.memory import settled_objects
from tests.server.engine.fakes import FakeRunner
from tests.server.engine_process.fake_engine import RealTime
from tests.server.engine_process.test_host import Process


class RealEngines(Process):
    """Loads engines as they are, each with a runner, which stands for a model's weights."""

    def __init__(self) -> None:
        self.runners: list[weakref.ref[FakeRunner]] = []
        super().__init__()

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        runner = FakeRunner(RealTime())  # type: ignore[arg-type]
        self.runners.append(weakref.ref(runner))
        engine = Engine(runner, RealTime(), deliver, EngineConfig(), observe=observe, inbox=inbox)
        return Built(engine, runner.facts, "CC0-1.0")


@pytest.mark.parametrize("unloaded", [1, 2])
def test_a_model_that_is_unloaded_is_freed_though_what_is_loaded_is_left_out_of_collection(unloaded: int) -> None:
    with settled_objects():
        process = RealEngines()
        for slot in (1, 2):
            process.load(slot)
        process.tell(Unload(unloaded))
        assert process.hear_of(Unloaded) == Unloaded(unloaded)
        process.tell(LoadEncoder(2))  # what is loaded next comes after that
        process.hear_of(EncoderReady)
        assert [runner() is None for runner in process.runners] == [unloaded == 1, unloaded == 2]
        process.tell(Stop())
        while process.thread.is_alive():
            process.hear(10)
        process.end.close()
        process.gateway.close()
