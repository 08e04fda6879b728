"""A load that fails half-way leaves nothing behind, and does not disturb a served model of the same name."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import ModelFacts
from motiongen_server.engine.types.report import StepReport
from motiongen_server.models.factory import Engines, ModelFactory
from motiongen_server.ops.metrics import Metrics
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities, PresetText
from motiongen_server.settings import SettingError
from motiongen_server.text.ports import TextEncoder
from tests.contract.local import LengthEncoder
from tests.server.engine.fakes import FACTS


@dataclass
class Model:
    """A loaded model."""

    facts: ModelFacts = FACTS
    licence: str = "CC0-1.0"
    abilities: Any = NOTHING_CLAIMED
    is_stopped: bool = False

    def stop(self) -> None:
        self.is_stopped = True


@dataclass
class Loads:
    """Engines that load the same model each time, and report 40 sent frames at once. is_sound: it can be served."""

    metrics: Metrics
    is_sound: bool = True
    abilities: Abilities = NOTHING_CLAIMED
    made: list[Model] = field(default_factory=list)

    def load(self, source: str) -> Model:
        self.metrics.of_engine(FACTS.model_id, "0").observe(StepReport(frames_sent=40))
        self.made.append(Model(abilities=self.abilities if self.is_sound else None))
        return self.made[-1]

    def load_text(self, facts: ModelFacts) -> TextEncoder:
        if not self.is_sound:
            raise SettingError("there is no such encoder")
        return LengthEncoder()


async def test_failed_load_removes_the_models_metrics_unless_one_of_its_name_is_served() -> None:
    metrics = Metrics()
    factory, loads = ModelFactory(ServerConfig(), metrics), Loads(metrics, is_sound=False)
    factory.use(cast(Engines, loads))

    def frames_sent() -> float | None:
        labels = {"model": FACTS.model_id, "engine": "0"}
        return metrics.registry.get_sample_value("motiongen_frames_sent_total", labels)

    with pytest.raises(SettingError):
        await factory.load("fake")
    assert loads.made[0].is_stopped
    assert frames_sent() is None
    loads.is_sound = True
    served = await factory.load("fake")
    assert frames_sent() == 40
    loads.is_sound = False
    with pytest.raises(AttributeError):
        await factory.load("fake")
    assert loads.made[2].is_stopped
    assert frames_sent() == 80, "they belong to the served model of this name"
    factory.forget(served)
    assert frames_sent() is None
    build = {"model": FACTS.model_id, "rig": FACTS.rig.rig_id}
    assert metrics.registry.get_sample_value("motiongen_build_info", build) is None
    with pytest.raises(AttributeError):
        await factory.load("fake")
    assert frames_sent() is None, "no model of that name is served any more"
    factory.close()


async def test_presets_texts_are_encoded_when_the_model_loads() -> None:
    metrics = Metrics()
    factory, loads = ModelFactory(ServerConfig(), metrics), Loads(metrics)
    factory.use(cast(Engines, loads))
    loads.abilities = Abilities(presets=(PresetText("bow", "a person bows", ""),))
    served = await factory.load("fake")
    known = served.prompts.cached("a person bows")
    assert known is not None
    assert np.array_equal(known, LengthEncoder().encode(["a person bows"])[0])
    factory.close()


@pytest.mark.parametrize("broken", ["open_store", "make_catalog"])
async def test_model_that_cannot_be_set_up_after_loading_is_stopped(
    broken: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise ValueError(broken)

    metrics = Metrics()
    factory, loads = ModelFactory(ServerConfig(), metrics), Loads(metrics)
    factory.use(cast(Engines, loads))
    labels = {"model": FACTS.model_id, "rig": FACTS.rig.rig_id}
    with monkeypatch.context() as patched:
        patched.setattr(f"motiongen_server.models.factory.{broken}", fail)
        with pytest.raises(ValueError, match=broken):
            await factory.load("fake")
    assert loads.made[0].is_stopped, "otherwise every engine process would keep it for good"
    assert metrics.registry.get_sample_value("motiongen_build_info", labels) is None
    await factory.load("fake")
    assert not loads.made[1].is_stopped
    assert metrics.registry.get_sample_value("motiongen_build_info", labels) == 1
    factory.close()
