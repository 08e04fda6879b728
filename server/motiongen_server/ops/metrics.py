"""Every Prometheus metric, declared once; those of engines in `model_metrics`. No label names a session or prompt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Protocol

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Metric, ProcessCollector
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from motiongen_server.ops.model_metrics import LATENCY_BUCKETS, ByEngine, EngineMetrics

CLIP_BUCKETS = (0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 150.0, 300.0, 600.0)


class WatchedProcess(Protocol):
    """An engine process, as far as metrics tell of it. pid: None while there is none."""

    @property
    def pid(self) -> int | None: ...

    @property
    def num_restarts(self) -> int: ...

    @property
    def rss_bytes(self) -> int: ...


class WatchedWriter(Protocol):
    """The way to the store of snapshots, as far as metrics tell of it."""

    @property
    def lag_s(self) -> float: ...

    @property
    def is_failing(self) -> bool: ...


class WatchedModels(Protocol):
    """The models that are offered, as far as metrics tell of them. From any thread. num_engines: by their names."""

    @property
    def free_share(self) -> float: ...

    @property
    def num_engines(self) -> Mapping[str, int]: ...


class WatchedService(Protocol):
    """The edge, as far as metrics tell of it."""

    @property
    def num_streams(self) -> int: ...

    @property
    def num_parked(self) -> int: ...

    @property
    def num_waiting_bytes(self) -> int: ...

    @property
    def num_other_servers(self) -> int: ...

    @property
    def gateway_lag_s(self) -> float: ...

    @property
    def loop_taken_s(self) -> float: ...

    @property
    def num_held_back(self) -> int: ...


class CountedByService(Collector):
    """What the edge counts itself, with every message: a counter of Prometheus's takes longer. service: once known."""

    def __init__(self) -> None:
        self.service: WatchedService | None = None

    def collect(self) -> Iterable[Metric]:
        service = self.service
        yield CounterMetricFamily(
            "motiongen_client_loop_seconds",
            "Time of the gateway's event loop that went into what clients sent, and into the answers.",
            0.0 if service is None else service.loop_taken_s,
        )
        yield CounterMetricFamily(
            "motiongen_streams_held_back",
            "Times that a stream was not read on for what it had taken of the gateway's event loop.",
            0.0 if service is None else service.num_held_back,
        )


class CountedByModel(Collector):
    """What is told of each model that is offered, by its name. models: once there are any."""

    def __init__(self) -> None:
        self.models: WatchedModels | None = None

    def collect(self) -> Iterable[Metric]:
        family = GaugeMetricFamily(
            "motiongen_model_engines", "Engine processes that serve a model at this moment.", labels=["model"]
        )
        for model_id, num_engines in ({} if self.models is None else self.models.num_engines).items():
            family.add_metric([model_id], num_engines)
        yield family


class Metrics:
    """The server's metrics, in a registry of their own."""

    def __init__(self) -> None:
        registry = CollectorRegistry()
        self.registry = registry
        self._by_engine = ByEngine()
        registry.register(self._by_engine)
        self._by_service = CountedByService()
        registry.register(self._by_service)
        self._by_model = CountedByModel()
        registry.register(self._by_model)
        self.build = Gauge("motiongen_build_info", "What runs, always 1.", ["model", "rig"], registry=registry)
        self.prompts = Counter(
            "motiongen_prompts",
            "Prompts that were not in memory: from the store, from the encoder, or why they did not come.",
            ["source"],
            registry=registry,
        )
        self.prompts_waiting = Gauge(
            "motiongen_prompts_waiting", "Prompts that wait for the text encoder.", registry=registry
        )
        self.prompt_seconds = Histogram(
            "motiongen_prompt_encode_seconds",
            "Encoding a prompt that was not in the cache.",
            buckets=LATENCY_BUCKETS,
            registry=registry,
        )
        self.rejects = Counter(
            "motiongen_admission_rejects",
            "Sessions refused for want of room, by reason.",
            ["reason"],
            registry=registry,
        )
        self.slow_readers = Counter(
            "motiongen_slow_reader_closes", "Streams whose sessions were closed for reading slowly.", registry=registry
        )
        self.resumes = Counter(
            "motiongen_session_resumes",
            "Sessions that another stream went on with, or could not, or that expired before one did.",
            ["how"],
            registry=registry,
        )
        self.snapshots = Counter(
            "motiongen_snapshots",
            "Snapshots of sessions: written, fenced (another server holds the session), lost.",
            ["what"],
            registry=registry,
        )
        self.snapshot_lag = Gauge(
            "motiongen_snapshot_lag_seconds",
            "For how long the oldest unwritten snapshot has waited.",
            registry=registry,
        )
        self.snapshot_store_up = Gauge(
            "motiongen_snapshot_store_up",
            "Whether the store of snapshots does its work; NaN where there is none.",
            registry=registry,
        )
        self.snapshot_store_up.set(math.nan)  # which no alert takes for a store that is away
        self.parked = Gauge(
            "motiongen_sessions_parked", "Sessions that wait for a client that lost its transport.", registry=registry
        )
        self.dropped = Counter(
            "motiongen_frames_dropped", "Frames taken out of a stream's queue unsent.", registry=registry
        )
        self.clips = Counter(
            "motiongen_clips", "Samples of clips asked for, by the status of their call.", ["code"], registry=registry
        )
        self.clip_seconds = Histogram(
            "motiongen_clip_seconds", "Calls for clips that were made, to their last frame.", buckets=CLIP_BUCKETS,
            registry=registry,
        )  # fmt: skip
        self.streams = Gauge("motiongen_streams", "Open streams.", registry=registry)
        self.free_share = Gauge(
            "motiongen_free_share",
            "Of the default model's capacity, what is left to new sessions, 0 to 1; 0 while the server drains.",
            registry=registry,
        )
        self.other_servers = Gauge(
            "motiongen_other_servers",
            "Servers of the same Redis whose room is known, to be named to clients that are refused; 8 at most.",
            registry=registry,
        )
        self.tasks = Gauge("motiongen_event_loop_tasks", "Tasks of the gateway's event loop.", registry=registry)
        self.gateway_lag = Gauge(
            "motiongen_gateway_lag_seconds",
            "How long messages wait for the gateway's event loop, the median of a second.",
            registry=registry,
        )
        self.queue_bytes = Gauge(
            "motiongen_outbound_queue_bytes",
            "What waits to be written to all clients, to be told again, or to be taken from them.",
            registry=registry,
        )
        self.heartbeat_age = Gauge(
            "motiongen_engine_heartbeat_age_seconds", "Since the engine's loop last went round.", registry=registry
        )
        self.engine_up = Gauge(
            "motiongen_engine_up", "Whether there is an engine process.", ["engine"], registry=registry
        )
        self.engine_restarts = Gauge(
            "motiongen_engine_restarts",
            "Engine processes started in place of lost ones.",
            ["engine"],
            registry=registry,
        )
        self.engine_memory = Gauge(
            "motiongen_engine_resident_memory_bytes", "Memory of an engine process.", ["engine"], registry=registry
        )
        ProcessCollector(registry=registry)

    def of_engine(self, model_id: str, engine: str) -> EngineMetrics:
        """Those of a model on an engine, from now on. From any thread."""
        return self._by_engine.of(model_id, engine)

    def watch_process(self, engine: str, process: WatchedProcess) -> None:
        """Tell of an engine process whenever somebody asks."""
        self.engine_up.labels(engine).set_function(lambda: float(process.pid is not None))
        self.engine_restarts.labels(engine).set_function(lambda: process.num_restarts)
        self.engine_memory.labels(engine).set_function(lambda: process.rss_bytes)

    def watch_models(self, models: WatchedModels) -> None:
        """Tell of the models that are offered whenever somebody asks."""
        self._by_model.models = models
        self.free_share.set_function(lambda: models.free_share)

    def watch_service(self, service: WatchedService) -> None:
        """Tell of streams and sessions whenever somebody asks."""
        self._by_service.service = service
        self.streams.set_function(lambda: service.num_streams)
        self.parked.set_function(lambda: service.num_parked)
        self.queue_bytes.set_function(lambda: service.num_waiting_bytes)
        self.gateway_lag.set_function(lambda: service.gateway_lag_s)
        self.other_servers.set_function(lambda: service.num_other_servers)

    def watch_snapshots(self, writer: WatchedWriter) -> None:
        """Tell of the way to the store of snapshots whenever somebody asks."""
        self.snapshot_lag.set_function(lambda: writer.lag_s)
        self.snapshot_store_up.set_function(lambda: float(not writer.is_failing))

    def forget_model(self, model_id: str) -> None:
        """Tell nothing more of a model's engines."""
        self._by_engine.forget(model_id)

    def load_of(self, model_id: str) -> float:
        """The share of the machine that is spoken for, as a model's engines saw it on average."""
        return self._by_engine.load(model_id)

    def count_prompt(self, source: str) -> None:
        """Note a prompt that was not in memory: where it came from, or the reason for which it did not."""
        self.prompts.labels(source).inc()

    def reject(self, reason: str) -> None:
        """As in StreamMetrics."""
        self.rejects.labels(reason).inc()

    def end_clip(self, code: str, seconds: float, num_samples: int) -> None:
        """As in StreamMetrics."""
        self.clips.labels(code).inc(num_samples)
        if code == "OK":
            self.clip_seconds.observe(seconds)

    def count_resume(self, how: str) -> None:
        """As in StreamMetrics."""
        self.resumes.labels(how).inc()

    def count_snapshot(self, what: str) -> None:
        """As in StreamMetrics."""
        self.snapshots.labels(what).inc()

    def give_up_on_reader(self) -> None:
        """As in StreamMetrics."""
        self.slow_readers.inc()

    def drop_frames(self, count: int) -> None:
        """As in StreamMetrics."""
        self.dropped.inc(count)
