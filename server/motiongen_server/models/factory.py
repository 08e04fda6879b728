"""ModelFactory: makes all that serving a model needs, from its name: engine, text encoder, catalogue and metrics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from motiongen_server.background import start_in_background
from motiongen_server.config import ServerConfig
from motiongen_server.engine.engine_port import EnginePort
from motiongen_server.engine.types import Guidance, ModelFacts
from motiongen_server.models.loader import load_repertoire, open_store
from motiongen_server.models.registry import LoadedModel
from motiongen_server.models.repertoire import NOTHING_SAID, Repertoire
from motiongen_server.ops.metrics import Metrics
from motiongen_server.rpc.abilities import Abilities
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.limits import Limits, PeerLimits, ServiceLimits
from motiongen_server.text.ports import TextEncoder
from motiongen_server.text.prompts import PromptEncoder


class ModelEngine(EnginePort, Protocol):
    """A model that is loaded and takes events, with its facts, licence and abilities."""

    @property
    def facts(self) -> ModelFacts: ...

    @property
    def licence(self) -> str: ...

    @property
    def abilities(self) -> Abilities: ...


@dataclass(frozen=True)
class _Parts:
    """What is loaded on a thread of its own, in one go."""

    engine: ModelEngine
    encoder: TextEncoder
    repertoire: Repertoire


class Engines(Protocol):
    """The engine processes, or a substitute for them. Used from any thread. `str` of it is logged."""

    def load(self, source: str) -> ModelEngine:
        """Load a model and measure it. Raises SettingError."""
        ...

    def load_text(self, facts: ModelFacts) -> TextEncoder:
        """Load the text encoder for a model. Raises SettingError."""
        ...

    def stop(self) -> None:
        """End all engines, at once those that are still loading."""
        ...

    def join(self) -> bool:
        """Wait for their end, with a time limit. True if all have ended."""
        ...


class ModelFactory:
    """Loads models; those that need the same text encoder share it. Its coroutine runs on the event loop only."""

    def __init__(self, config: ServerConfig, metrics: Metrics) -> None:
        self._config = config
        self._metrics = metrics
        self._engines: Engines | None = None
        self._encoders: dict[int, TextEncoder] = {}
        self._prompts: dict[tuple[str, int], PromptEncoder] = {}
        self._served: set[str] = set()  # models by their ids

    def use(self, engines: Engines) -> None:
        """Set the engines to load models on; to be called before `load`."""
        self._engines = engines

    async def load(self, source: str) -> LoadedModel:
        """Load a model. Raises SettingError, or whatever else goes wrong with its engine."""
        parts = await start_in_background(lambda: self._load(source), "loading")
        try:
            served = self._joined(source, parts)
        except Exception:
            self._give_up(parts.engine)
            raise
        facts = parts.engine.facts
        self._served.add(facts.model_id)
        self._metrics.build.labels(facts.model_id, facts.rig.rig_id).set(1)
        return served

    def _joined(self, source: str, parts: _Parts) -> LoadedModel:
        facts = parts.engine.facts
        catalog = make_catalog(self._config, facts, parts.engine.licence, parts.encoder.identity, parts.repertoire)
        prompts = self._prompts_for(parts.encoder, facts)
        for preset in parts.repertoire.presets:
            prompts.remember(preset.text, preset.embedding)
        return LoadedModel(source, parts.engine, prompts, catalog, parts.engine.licence)

    def _load(self, source: str) -> _Parts:
        engines = self._engines
        if engines is None:
            raise RuntimeError("there are no engines yet")
        engine = engines.load(source)
        try:
            width = engine.facts.embedding_dim
            if width not in self._encoders:
                self._encoders[width] = engines.load_text(engine.facts)
            encoder = self._encoders[width]
            return _Parts(engine, encoder, load_repertoire(self._config, encoder, engine.facts, engine.abilities))
        except Exception:
            self._give_up(engine)
            raise

    def _give_up(self, engine: ModelEngine) -> None:
        """Unload a model that was loaded and cannot be served: nobody else would."""
        engine.stop()
        if engine.facts.model_id not in self._served:  # else its metrics belong to the model that is served
            self._metrics.forget_model(engine.facts.model_id)

    def forget(self, model: LoadedModel) -> None:
        """Remove the metrics of a model that has been unloaded."""
        facts = model.catalog.facts
        self._served.discard(facts.model_id)
        self._metrics.build.remove(facts.model_id, facts.rig.rig_id)
        self._metrics.forget_model(facts.model_id)

    def _prompts_for(self, encoder: TextEncoder, facts: ModelFacts) -> PromptEncoder:
        key = (encoder.identity, facts.embedding_dim)
        if key not in self._prompts:
            config, metrics = self._config, self._metrics
            self._prompts[key] = PromptEncoder(
                encoder,
                config.prompt_cache,
                observe=metrics.prompt_seconds.observe,
                store=open_store(config, encoder.identity, facts),
                timeout_s=config.prompt_timeout_s,
                max_waiting=config.max_waiting_prompts,
                count=metrics.count_prompt,
            )
        return self._prompts[key]

    @property
    def num_waiting_prompts(self) -> int:
        """Prompts that wait for an encoder."""
        return sum(prompts.num_waiting for prompts in tuple(self._prompts.values()))

    def close(self) -> None:
        """Close the encoders."""
        for prompts in self._prompts.values():
            prompts.close()


def make_limits(config: ServerConfig) -> ServiceLimits:
    """The limits of the service as a whole."""
    return ServiceLimits(
        max_streams=config.max_streams,
        max_clip_calls=config.max_clip_calls,
        hello_timeout_s=config.hello_timeout_s,
        empty_timeout_s=config.empty_timeout_s,
        stuck_timeout_s=config.stuck_timeout_s,
        silent_timeout_s=config.silent_timeout_s,
        max_waiting_bytes=config.max_waiting_mib << 20,
        reconnect_after_s=config.reconnect_after_s,
        loop_share=config.loop_share,
        peer=PeerLimits(
            streams=config.peer_streams,
            calls=config.peer_calls,
            events_per_second=config.peer_events_per_second,
            prompts_per_second=config.peer_prompts_per_second,
            calls_per_second=config.peer_calls_per_second,
            bytes_per_second=config.peer_bytes_per_second,
            session_weight=config.peer_session_weight,
            heroes=config.peer_heroes,
            clip_samples=config.peer_clip_samples,
        ),
    )


def make_catalog(
    config: ServerConfig, facts: ModelFacts, licence: str, text_encoder: str, repertoire: Repertoire = NOTHING_SAID
) -> Catalog:
    """The catalogue of a model: what its sessions may ask for."""
    limits = Limits(
        max_sessions_per_stream=config.max_sessions_per_stream,
        max_prompt_characters=config.max_prompt_characters,
        max_request_bytes=config.max_request_bytes,
        default_lookahead_frames=config.lookahead_for(facts.horizon),
        max_lookahead_frames=config.max_lookahead_frames,
        events_per_second=config.events_per_second,
        stream_events_per_second=config.stream_events_per_second,
        resume_grace_s=config.resume_grace_s,
    )
    guidance = Guidance(
        facts.guidance.text if config.text_guidance is None else config.text_guidance,
        facts.guidance.constraint if config.constraint_guidance is None else config.constraint_guidance,
    )
    return Catalog(
        facts,
        limits,
        guidance,
        licence,
        text_encoder=text_encoder,
        history_frames=facts.whole_patches(config.history_frames),
        presets=repertoire.presets,
        gaits=repertoire.gaits,
        abilities=repertoire.abilities,
    )
