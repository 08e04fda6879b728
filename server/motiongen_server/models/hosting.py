"""Where the engine runs: on a thread of this process, or in a process of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from motiongen_server.config import ServerConfig
from motiongen_server.engine.engine_port import EnginePort
from motiongen_server.engine.ports import Deliver, Observe
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.types import Gait, ModelFacts
from motiongen_server.errors import SettingError
from motiongen_server.models.loader import Loaded, build_engine, load_encoder, load_repertoire
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.text.presets import Preset
from motiongen_server.text.prompts import TextEncoder

ENGINE_COMMAND = (sys.executable, "-m", "motiongen_server.engine_process")
"""Starts an engine process, given the folder of its gateway's sockets."""


@dataclass(frozen=True)
class Hosted:
    """An engine that is loaded and warm but not started, and what the service needs to know of its model."""

    engine: EnginePort
    facts: ModelFacts
    encoder: TextEncoder
    licence: str
    threads: int
    presets: tuple[Preset, ...]
    gaits: tuple[Gait, ...] = ()
    abilities: Abilities = NOTHING_CLAIMED


def host_engine(
    config: ServerConfig,
    load: Callable[[ServerConfig], Loaded],
    deliver: Deliver,
    observe: Observe,
    engine_command: Sequence[str] = ENGINE_COMMAND,
    device: Device | None = None,
) -> Hosted:
    """Load and warm up. load, engine_command: for an engine in this process, and in one of its own.

    device: what engines of this process take turns on.

    Raises SettingError for settings that cannot be served.
    """
    if config.engine_process:
        return _in_its_own_process(config, deliver, observe, engine_command)
    loaded = load(config)
    engine = build_engine(config, loaded.runner, deliver, observe, device=device)
    return Hosted(
        engine,
        loaded.runner.facts,
        loaded.encoder,
        loaded.licence,
        loaded.threads,
        loaded.presets,
        loaded.gaits,
        loaded.abilities,
    )


def _in_its_own_process(
    config: ServerConfig, deliver: Deliver, observe: Observe, engine_command: Sequence[str]
) -> Hosted:
    from motiongen_server.engine_process.gateway import RemoteEngine  # pyzmq and msgpack are for those who ask for it

    engine = RemoteEngine(config, deliver, observe, engine_command)
    ready = engine.load()
    try:
        encoder = load_encoder(config, ready.facts)
        known = load_repertoire(config, encoder, ready.facts, ready.abilities)
    except SettingError:
        engine.stop()
        raise
    return Hosted(
        engine, ready.facts, encoder, ready.licence, ready.threads, known.presets, known.gaits, known.abilities
    )
