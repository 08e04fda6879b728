"""EnginePool: all engine processes of a server. Each holds every model; each session runs on one of them."""

from __future__ import annotations

import itertools
import logging
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, wait
from dataclasses import replace
from functools import partial
from operator import itemgetter

from motiongen_server.config import ServerConfig
from motiongen_server.devices import (
    EngineDevice,
    admit_load_for,
    devices_of,
    engines_at_work,
    spare_engines,
    usable_cores,
)
from motiongen_server.engine.ports import Deliver, Observe
from motiongen_server.engine.types import ModelFacts, StepsOf
from motiongen_server.engine_process.child import FreshChild, StartChild
from motiongen_server.engine_process.forking import ForkServerLink
from motiongen_server.engine_process.group import EngineGroup
from motiongen_server.engine_process.messages import Begin, Ready, StepsElsewhere
from motiongen_server.engine_process.process import HUNG_S, EngineProcess
from motiongen_server.engine_process.restarts import REST_S
from motiongen_server.engine_process.silence import LOAD_AGAIN_S
from motiongen_server.engine_process.text import EngineTextEncoder
from motiongen_server.models.loader import load_encoder
from motiongen_server.ops.metrics import Metrics
from motiongen_server.settings import SettingError
from motiongen_server.text.ports import TextEncoder

ENGINE_COMMAND = (sys.executable, "-m", "motiongen_server.engine_process")
"""Starts an engine process, given the folder of its gateway's sockets."""
END_S = 5.0
LOOK_EVERY_S = 1.0
"""How often to check whether something prevents a model from being loaded."""
_log = logging.getLogger(__name__)

ObserverOf = Callable[[str, str], Observe]
"""Returns what takes the reports of a model, by its id, on an engine, by its name."""


class EnginePool:
    """Loads models on all engine processes at once. Everything may be used from any thread."""

    def __init__(
        self,
        config: ServerConfig,
        devices: Sequence[EngineDevice],
        deliver: Deliver,
        observer_of: ObserverOf,
        command: Sequence[str] | None = None,
        *,
        hung_s: float = HUNG_S,
        rest_s: float = REST_S,
    ) -> None:
        """command: starts another program as engine process, given the folder of its gateway's sockets."""
        self._admit_load = admit_load_for(devices) if config.admit_load is None else config.admit_load
        config = replace(config, admit_load=self._admit_load)
        self._config = config
        self._observer_of = observer_of
        self._slots = itertools.count(1)
        self._text: EngineTextEncoder | None = None
        self._spare = spare_engines(devices)
        at_work = Counter(device.kind for device in engines_at_work(devices))
        # A single process takes less memory without a fork server, which stays in memory. CUDA is not forked.
        shares = command is None and sum(device.kind == "cpu" for device in devices) > 1
        self._fork_server = ForkServerLink() if shares else None
        fresh: StartChild = partial(FreshChild, command or ENGINE_COMMAND)

        def start_for(device: EngineDevice) -> StartChild:
            return fresh if self._fork_server is None or device.kind != "cpu" else self._fork_server.start

        self.processes = tuple(
            EngineProcess(
                str(number),
                device,
                Begin(config, device.kind, device.threads, at_work[device.kind]),
                deliver,
                start_for(device),
                hung_s=hung_s,
                rest_s=rest_s,
            )
            for number, device in enumerate(devices)
        )
        if any(self._spare):
            _log.warning(
                "%s; spare ones are given sessions only while others are lost, since these have threads for all %d "
                "cores; each holds the model: ask for fewer to save memory",
                self,
                usable_cores(),
            )
        for process in self.processes:
            process.start()

    def load(self, source: str) -> EngineGroup:
        """Load a model on every engine process, and wait until it is warm.

        Raises SettingError if the settings are wrong, EngineLost if it cannot be loaded for another reason.
        """
        slot = next(self._slots)
        links = [process.load_model(slot, source) for process in self.processes]
        ready = [link.ready for link in links]
        errors: list[BaseException] = []
        # The first that fails ends the wait: others may hang, and the model is not served anyway.
        while not errors and wait(ready, LOOK_EVERY_S, FIRST_EXCEPTION).not_done:
            errors = self._hindered() + _errors(ready)
        errors = errors or _errors(ready)
        ordered = sorted(zip(self._spare, self.processes, links, strict=True), key=itemgetter(0))
        members = tuple((process, link) for _, process, link in ordered)
        num_at_work = len(members) - sum(self._spare)
        group = EngineGroup(members, self._config.max_sessions, self._admit_load, num_at_work)
        if errors:
            group.stop()
            raise next((error for error in errors if isinstance(error, SettingError)), errors[0])
        if not all(link.is_of_model(links[0]) for link in links):
            group.stop()
            raise SettingError(
                f"{source!r} was changed while it was loaded: engine processes hold different models by that name; "
                "load it once it is whole"
            )
        for process, link in zip(self.processes, links, strict=True):
            link.observe = self._observer_of(link.ready.result().facts.model_id, process.name)
            link.on_quota_steps = partial(self._tell_others, process, slot)
        return group

    def _hindered(self) -> list[BaseException]:
        """Why models cannot be loaded now: a process is still loading again what it held before, on the same thread."""
        loading = [(process, "a model", process.absent.awaited_s) for process in self.processes]
        if self._text is not None:
            loading.append((self.processes[0], "the text encoder", self._text.loading_s))
        return [
            SettingError(
                f"engine {process.name} has been loading {what} again for {loading_s:.0f} s, and loads no other before "
                f"that ends; see what hinders it, then end process {process.pid}, which is started anew"
            )
            for process, what, loading_s in loading
            if loading_s > LOAD_AGAIN_S and process.pid is not None
        ]

    def _tell_others(self, process: EngineProcess, slot: int, taken: StepsOf) -> None:
        """Tell all engines what the engine of a slot did for owners that have a quota."""
        for each in self.processes:
            if each.pid is not None:  # a process that starts later starts its count at zero
                each.tell(StepsElsewhere(slot if each is process else 0, taken))

    def load_text(self, facts: ModelFacts) -> TextEncoder:
        """The text encoder for a model; if it needs no torch, in this process. Raises SettingError."""
        return load_encoder(self._config, facts, self._text_encoder)

    def _text_encoder(self, width: int, timeout_s: float) -> EngineTextEncoder:
        """The configured text encoder, in the first engine process. Raises SettingError if it cannot be loaded."""
        if self._text is None:
            self._text = EngineTextEncoder(self.processes[0], width, timeout_s)
        if self._text.width != width:
            raise SettingError(
                f"the text encoder gives vectors of {self._text.width} numbers, but the model takes {width}"
            )
        return self._text

    def stop(self) -> None:
        """End all engine processes, at once those that are loading a model for the first time."""
        for process in self.processes:
            process.stop()
        if self._fork_server is not None:
            self._fork_server.stop()

    def join(self, timeout_s: float = END_S) -> bool:
        """Wait for their end; those that do not end in time are killed."""
        ends_at = time.monotonic() + timeout_s
        ends = [process.join(max(0.0, ends_at - time.monotonic())) for process in self.processes]
        if self._fork_server is not None:
            self._fork_server.join(max(0.0, ends_at - time.monotonic()))
        return all(ends)

    def __str__(self) -> str:
        spare = [" (spare)" if spare else "" for spare in self._spare]
        engines = zip(self.processes, spare, strict=True)
        return "engines on " + ", ".join(f"{process.name}: {process.device}{note}" for process, note in engines)


def _errors(loads: Sequence[Future[Ready]]) -> list[BaseException]:
    return [error for load in loads if load.done() and (error := load.exception()) is not None]


def start_engine_processes(
    config: ServerConfig, deliver: Deliver, metrics: Metrics, command: Sequence[str] | None = None
) -> EnginePool:
    """The engine processes that the settings ask for. Raises SettingError if there are no such devices."""

    def observer_of(model_id: str, engine: str) -> Observe:
        return metrics.of_engine(model_id, engine).observer()

    pool = EnginePool(config, devices_of(config.devices), deliver, observer_of, command)
    for process in pool.processes:
        metrics.watch_process(process.name, process)
    return pool
