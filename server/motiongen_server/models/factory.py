"""ModelFactory: makes of a model's name all that serving it takes: engine, text encoder, catalogue and metrics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.scheduling.report import StepReport
from motiongen_server.engine.types import Guidance
from motiongen_server.models.hosting import Hosted, host_engine
from motiongen_server.models.loader import Loaded, open_store
from motiongen_server.models.registry import Served
from motiongen_server.ops.metrics import Metrics
from motiongen_server.ops.model_metrics import EngineMetrics
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.limits import Limits
from motiongen_server.text.prompts import PromptEncoder


class ModelFactory:
    """Models of one server: they share a device, and an encoder where they take the same."""

    def __init__(
        self,
        config: ServerConfig,
        load: Callable[[ServerConfig], Loaded],
        deliver: Deliver,
        metrics: Metrics,
        engine_command: Sequence[str],
    ) -> None:
        """load, engine_command: as for `host_engine`."""
        self._config = config
        self._load = load
        self._deliver = deliver
        self._metrics = metrics
        self._engine_command = engine_command
        self._device = Device()
        self._prompts: dict[tuple[str, int], PromptEncoder] = {}

    def host(self, source: str) -> Hosted:
        """Load a model, on any thread. Raises SettingError."""
        observe = _Observe()
        config = replace(self._config, model=source)
        hosted = host_engine(config, self._load, self._deliver, observe, self._engine_command, self._device)
        observe.metrics = self._metrics.of_model(hosted.facts.model_id)
        return hosted

    def serve(self, hosted: Hosted) -> Served:
        """Make ready to offer it, on the event loop."""
        self._metrics.build.labels(hosted.facts.model_id, hosted.facts.rig.rig_id).set(1)
        return Served(hosted.engine, self._prompts_for(hosted), make_catalog(self._config, hosted))

    def forget(self, hosted: Hosted) -> None:
        """Measure nothing more of a model that has been unloaded."""
        self._metrics.build.remove(hosted.facts.model_id, hosted.facts.rig.rig_id)
        self._metrics.forget_model(hosted.facts.model_id)

    def _prompts_for(self, hosted: Hosted) -> PromptEncoder:
        key = (hosted.encoder.identity, hosted.facts.embedding_dim)
        if key not in self._prompts:
            self._prompts[key] = self._make_prompts(hosted)
        for preset in hosted.presets:
            self._prompts[key].remember(preset.text, preset.embedding)
        return self._prompts[key]

    def _make_prompts(self, hosted: Hosted) -> PromptEncoder:
        config, metrics = self._config, self._metrics
        return PromptEncoder(
            hosted.encoder,
            config.prompt_cache,
            metrics.prompt_seconds.observe,
            store=open_store(config, hosted.encoder.identity, hosted.facts),
            timeout_s=config.prompt_timeout_s,
            max_waiting=config.max_waiting_prompts,
            count=metrics.count_prompt,
        )

    @property
    def num_waiting_prompts(self) -> int:
        """Prompts that wait for an encoder."""
        return sum(prompts.num_waiting for prompts in tuple(self._prompts.values()))

    def close(self) -> None:
        """End the encoders."""
        for prompts in self._prompts.values():
            prompts.close()


class _Observe:
    """Counts an engine's steps once it is known which model that is."""

    def __init__(self) -> None:
        self.metrics: EngineMetrics | None = None

    def __call__(self, report: StepReport) -> None:
        if self.metrics is not None:
            self.metrics.observe(report)


def make_catalog(config: ServerConfig, hosted: Hosted) -> Catalog:
    """What sessions with a model may ask for."""
    limits = Limits(
        max_sessions_per_stream=config.max_sessions_per_stream,
        max_prompt_characters=config.max_prompt_characters,
        max_request_bytes=config.max_request_bytes,
        default_lookahead_frames=config.lookahead_for(hosted.facts.horizon),
        max_lookahead_frames=config.max_lookahead_frames,
        events_per_second=config.events_per_second,
        stream_events_per_second=config.stream_events_per_second,
    )
    own = hosted.facts.guidance
    guidance = Guidance(
        own.text if config.text_guidance is None else config.text_guidance,
        own.constraint if config.constraint_guidance is None else config.constraint_guidance,
    )
    encoder = hosted.encoder.identity
    return Catalog(
        hosted.facts,
        limits,
        guidance,
        hosted.licence,
        encoder,
        config.history_frames,
        hosted.presets,
        hosted.gaits,
        hosted.abilities,
    )
