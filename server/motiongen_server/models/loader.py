"""What start-up loads: the model with its runner, the text encoder that fits it, and the engine around them."""

from __future__ import annotations

import logging
import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from motiongen_server.config import ServerConfig
from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.engine import Engine
from motiongen_server.engine.ports import Deliver, Inbox, Observe, Runner
from motiongen_server.engine.scheduling.device import Device, InTurns
from motiongen_server.engine.scheduling.profile import profile
from motiongen_server.engine.scheduling.scheduler import Scheduler
from motiongen_server.engine.types import Gait, ModelFacts
from motiongen_server.errors import SettingError
from motiongen_server.models.repertoire import Repertoire, as_abilities, encoded
from motiongen_server.rpc.abilities import NOTHING_CLAIMED, Abilities
from motiongen_server.text.presets import Preset
from motiongen_server.text.prompts import Store, TextEncoder

if TYPE_CHECKING:
    from motiongen_server.text.encoder.client import RemoteEncoder

_log = logging.getLogger(__name__)

REMOTE_ENCODER = "grpc:"


class MonotonicClock:
    """The engine's clock."""

    def now(self) -> float:
        return time.monotonic()


@dataclass(frozen=True)
class LoadedModel:
    """The runner, the weights' licence, the CPU threads that the model uses, and what it was trained for."""

    runner: Runner
    licence: str
    threads: int
    abilities: Abilities = NOTHING_CLAIMED


@dataclass(frozen=True)
class Loaded:
    """Everything of a server in one process: the runner, the encoder that fits its model, licence and CPU threads."""

    runner: Runner
    encoder: TextEncoder
    licence: str
    threads: int
    presets: tuple[Preset, ...] = ()
    gaits: tuple[Gait, ...] = ()
    abilities: Abilities = NOTHING_CLAIMED


class Loader:
    """Loads models with their text encoders. Models of the same width of text share an encoder."""

    def __init__(self) -> None:
        self._encoders: dict[tuple[str, int], TextEncoder] = {}

    def __call__(self, config: ServerConfig) -> Loaded:
        """The configured model and its text encoder. Raises SettingError saying what is wrong with the settings."""
        model = load_model(config)
        facts = model.runner.facts
        key = (config.text_encoder, facts.embedding_dim)
        if key not in self._encoders:
            self._encoders[key] = load_encoder(config, facts)
        encoder = self._encoders[key]
        repertoire = load_repertoire(config, encoder, facts, model.abilities)
        return Loaded(
            model.runner,
            encoder,
            model.licence,
            model.threads,
            repertoire.presets,
            repertoire.gaits,
            repertoire.abilities,
        )


def load_model(config: ServerConfig) -> LoadedModel:
    """The configured model. Raises SettingError saying what is wrong with the settings.

    torch is imported here and not above, so that the ports answer while that takes its seconds, and so that a process
    without the engine never imports it.
    """
    # Threads that wait for each other by spinning make every product several times slower as soon as another process
    # wants a core. OpenMP reads this once, when torch is loaded.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    import torch

    from motiongen_ardy.capabilities import read_capabilities
    from motiongen_ardy.checkpoint.model_card import model_folder, read_model_card
    from motiongen_server.runner import load_runner

    if config.device == "cuda" and not torch.cuda.is_available():
        raise SettingError("device is 'cuda', but torch finds no CUDA device and driver here; use cpu")
    if config.threads:
        torch.set_num_threads(config.threads)
    try:
        runner = load_runner(config.model, config.device, config.denoise_steps, config.precision)
        folder = model_folder(config.model)
        card = read_model_card(folder)
        abilities = as_abilities(read_capabilities(folder))
    except (ValueError, RuntimeError) as error:
        raise SettingError(f"cannot serve model {config.model!r}: {error}") from error
    return LoadedModel(runner, card.licence, torch.get_num_threads(), abilities)


def load_encoder(config: ServerConfig, facts: ModelFacts) -> TextEncoder:
    """The configured text encoder. Raises SettingError where there is none or it does not fit the model."""
    from motiongen_ardy.text import check_width, load_text_encoder

    name, width = config.text_encoder, facts.embedding_dim
    try:
        if name.startswith(REMOTE_ENCODER):
            remote = _remote_encoder(config)
            check_width(name, remote.width, width)
            return remote
        return load_text_encoder(name, width, config.text_device, config.text_precision, 2 * config.prompt_timeout_s)
    except (ValueError, RuntimeError, ConnectionError) as error:
        raise SettingError(f"cannot serve model {config.model!r} with text encoder {name!r}: {error}") from error


def _remote_encoder(config: ServerConfig) -> RemoteEncoder:
    """The encoder at an address; if it is away and the prompt store knows what it was, that, and it may come later."""
    from motiongen_ardy.text import TextEncoderUnavailable
    from motiongen_ardy.text.store import known_encoder
    from motiongen_server.text.encoder.client import RemoteEncoder

    address = config.text_encoder.removeprefix(REMOTE_ENCODER)
    # Longer than anybody waits, so that a slow answer is there for the next who asks.
    timeout_s = 2 * config.prompt_timeout_s
    try:
        return RemoteEncoder(address, timeout_s)
    except TextEncoderUnavailable as error:
        known = known_encoder(Path(config.prompt_store), config.text_encoder) if config.prompt_store else None
        if known is None:
            raise
        _log.warning("%s; until it does, only prompts are served that %s has kept", error, config.prompt_store)
        return RemoteEncoder(address, timeout_s, known)


def load_presets(config: ServerConfig, text_encoder: str, facts: ModelFacts) -> tuple[Preset, ...]:
    """The configured presets. Raises SettingError where they are from another encoder than the server's."""
    if not config.presets:
        return ()
    from motiongen_ardy.text.prompt_file import PromptFileError, read_prompt_file

    try:
        prompts = read_prompt_file(Path(config.presets))
    except PromptFileError as error:
        raise SettingError(f"cannot use presets: {error}") from error
    if prompts.text_encoder != text_encoder or prompts.vectors.shape[1] != facts.embedding_dim:
        raise SettingError(
            f"the presets of {config.presets} are {prompts.vectors.shape[1]} numbers each, from the text encoder "
            f"{prompts.text_encoder!r}; {facts.model_id} takes {facts.embedding_dim}, here from {text_encoder!r}"
        )
    return tuple(map(Preset, prompts.ids, prompts.texts, prompts.vectors))


def load_repertoire(config: ServerConfig, encoder: TextEncoder, facts: ModelFacts, abilities: Abilities) -> Repertoire:
    """The prompts of the checkpoint and the configured presets, which take the place of those of the same name.

    Raises SettingError as `load_presets` does.
    """
    own = load_presets(config, encoder.identity, facts)
    repertoire = encoded(abilities, encoder, facts.model_id)
    named = {preset.preset_id: preset for preset in (*repertoire.presets, *own)}
    return replace(repertoire, presets=tuple(named.values()))


def open_store(config: ServerConfig, text_encoder: str, facts: ModelFacts) -> Store | None:
    """Where embeddings outlive the process, None where that is not asked for."""
    if not config.prompt_store:
        return None
    from motiongen_ardy.text.store import VectorStore

    store = VectorStore(Path(config.prompt_store), text_encoder, facts.embedding_dim, config.prompt_store_size)
    store.note_encoder(config.text_encoder)
    return store


def check_fit(config: ServerConfig, facts: ModelFacts) -> None:
    """Raise SettingError where the settings ask for what the model cannot do."""
    if not facts.min_steps <= config.denoise_steps <= facts.max_steps:
        raise SettingError(
            f"denoise_steps is {config.denoise_steps}; {facts.model_id} takes {facts.min_steps} to {facts.max_steps}"
        )
    for name, given in (
        ("lookahead_frames", config.lookahead_for(facts.horizon)),
        ("max_lookahead_frames", config.max_lookahead_frames),
    ):
        if given < facts.horizon:
            raise SettingError(f"{name} is {given}; {facts.model_id} needs at least {facts.horizon}")


def build_engine(
    config: ServerConfig,
    runner: Runner,
    deliver: Deliver,
    observe: Observe,
    inbox: Inbox | None = None,
    device: Device | None = None,
) -> Engine:
    """Check that the settings fit, measure the model, and make the engine. Raises SettingError where they do not.

    device: where other engines are at work; they wait for single calls of what is measured.
    """
    check_fit(config, runner.facts)
    clock = MonotonicClock()
    lease = (device or Device()).lease()
    try:
        measured = profile(InTurns(runner, lease), clock, config.max_rows, config.history_frames, config.profile_s)
        engine_config = EngineConfig(
            max_sessions=config.max_sessions,
            max_rows=measured.max_rows,
            max_step_s=config.max_step_ms / 1000,
            history_crop=config.history_frames,
            flush_s=config.flush_ms / 1000,
            idle_timeout_s=config.idle_timeout_s,
            admit_load=admit_loads(config.admit_load),
            degrade=config.degrade,
        )
        scheduler = Scheduler(measured.costs, measured.max_rows, max_step_s=engine_config.max_step_s)
        return Engine(runner, clock, deliver, engine_config, observe, inbox, scheduler, lease)
    except ValueError as error:
        lease.leave()
        raise SettingError(str(error)) from error
    except Exception:
        lease.leave()
        raise


def admit_loads(load: float) -> tuple[float, float, float, float]:
    """Up to which load each class is let in: heroes a little beyond, so that there is room for them, the rest below."""
    hero, near, crowd, batch = 1.05, 1.0, 0.95, 0.8
    return hero * load, near * load, crowd * load, batch * load
