"""Engines on threads of the test's process, with any runner that a test loads, instead of engine processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from motiongen_server.app import MakeEngines
from motiongen_server.config import ServerConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Runner
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.types import Event, EventRefused, ModelFacts, Outcome, Owner, Priority
from motiongen_server.engine_process.model_loading import build_engine
from motiongen_server.ops.metrics import Metrics
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.text.ports import TextEncoder
from tests.server.engine.engine_thread import EngineThread

ENGINE = "0"
"""The name of the only engine, in metrics."""


@dataclass(frozen=True)
class InProcessModel:
    """A model's engine, with its reports."""

    engine: Engine
    thread: EngineThread
    facts: ModelFacts
    licence: str
    abilities: Abilities = NOTHING_CLAIMED

    @property
    def num_sessions(self) -> int:
        return self.engine.num_sessions

    @property
    def heartbeat_at(self) -> float:
        return self.engine.heartbeat_at

    @property
    def failure(self) -> BaseException | None:
        return self.thread.failure

    @property
    def num_engines(self) -> int:
        return int(self.failure is None)

    @property
    def free_share(self) -> float:
        return self.engine.free_share

    def submit(self, event: Event) -> Outcome | None:
        return self.engine.submit(event)

    def note_owner(self, owner: Owner) -> None:
        self.engine.intake.note_owner(owner)

    def refusal_of(self, priority: Priority, denoise_steps: int, *, is_clip: bool = False) -> EventRefused | None:
        return self.engine.refusal_of(priority, denoise_steps, is_clip=is_clip)

    def drain(self) -> None:
        self.engine.drain()

    def stop(self) -> None:
        self.engine.stop()

    def join(self, timeout_s: float | None = None) -> bool:
        return self.thread.join(timeout_s)


class InProcessEngines:
    """Satisfies `motiongen_server.models.factory.Engines`."""

    def __init__(
        self,
        config: ServerConfig,
        deliver: Deliver,
        metrics: Metrics,
        load: Callable[[ServerConfig], Runner],
        encoder: TextEncoder,
    ) -> None:
        self._config = config
        self._deliver = deliver
        self._metrics = metrics
        self._load = load
        self._encoder = encoder
        self._device = Device()

    def __str__(self) -> str:
        return "an engine of this process"

    def load(self, source: str) -> InProcessModel:
        config = replace(self._config, model=source)
        runner = self._load(config)
        observe = self._metrics.of_engine(runner.facts.model_id, ENGINE)
        engine = build_engine(
            config, runner, self._deliver, lambda report: observe.observe(report), device=self._device
        )
        return InProcessModel(engine, EngineThread(engine), runner.facts, "CC0-1.0")

    def load_text(self, facts: ModelFacts) -> TextEncoder:
        return self._encoder

    def stop(self) -> None:
        """Does nothing: each model's engine is stopped separately."""

    def join(self) -> bool:
        return True


def in_process(load: Callable[[ServerConfig], Runner], encoder: TextEncoder) -> MakeEngines:
    """A function that creates such engines for an application."""
    return lambda config, deliver, metrics: InProcessEngines(config, deliver, metrics, load, encoder)
