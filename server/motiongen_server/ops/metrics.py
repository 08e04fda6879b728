"""The Prometheus metrics; those of engines are in `model_metrics`. No label names a session or a prompt."""

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
    """What the metrics need of an engine process. pid: None while there is no process."""

    @property
    def pid(self) -> int | None: ...

    @property
    def num_restarts(self) -> int: ...

    @property
    def rss_bytes(self) -> int: ...


class WatchedWriter(Protocol):
    """What the metrics need of the snapshot writer."""

    @property
    def lag_s(self) -> float: ...

    @property
    def is_failing(self) -> bool: ...


class WatchedModels(Protocol):
    """What the metrics need of the models that are offered. From any thread. num_engines: by model id."""

    @property
    def free_share(self) -> float: ...

    @property
    def num_engines(self) -> Mapping[str, int]: ...


class WatchedService(Protocol):
    """What the metrics need of the edge."""

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
    """Counts that the edge keeps itself, since a Prometheus counter takes too long for every message.

    service: None until it exists.
    """

    def __init__(self) -> None:
        self.service: WatchedService | None = None

    def collect(self) -> Iterable[Metric]:
        service = self.service
        yield CounterMetricFamily(
            "motiongen_client_loop_seconds",
            "Time of the gateway's event loop spent on what clients sent, and on the answers.",
            0.0 if service is None else service.loop_taken_s,
        )
        yield CounterMetricFamily(
            "motiongen_streams_held_back",
            "Times that a stream was not read for a while because of the event loop time that it had taken.",
            0.0 if service is None else service.num_held_back,
        )


class CountedByModel(Collector):
    """What is exported for each model that is offered. models: None until there are any."""

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
        self.build = Gauge("motiongen_build_info", "What is running, always 1.", ["model", "rig"], registry=registry)
        self.prompts = Counter(
            "motiongen_prompts",
            "Prompts that were not in memory: from the store, from the encoder, or why they were refused.",
            ["source"],
            registry=registry,
        )
        self.prompts_waiting = Gauge(
            "motiongen_prompts_waiting", "Prompts that wait for the text encoder.", registry=registry
        )
        self.prompt_seconds = Histogram(
            "motiongen_prompt_encode_seconds",
            "Time to encode a prompt that was neither in memory nor in the prompt store, waiting included.",
            buckets=LATENCY_BUCKETS,
            registry=registry,
        )
        self.rejects = Counter(
            "motiongen_admission_rejects",
            "Sessions refused because the machine is full or by a quota, by reason.",
            ["reason"],
            registry=registry,
        )
        self.slow_readers = Counter(
            "motiongen_slow_reader_closes", "Streams whose sessions were closed for slow reading.", registry=registry
        )
        self.resumes = Counter(
            "motiongen_session_resumes",
            "Sessions of lost connections, by what became of them.",
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
            "How long the oldest unwritten snapshot has waited.",
            registry=registry,
        )
        self.snapshot_store_up = Gauge(
            "motiongen_snapshot_store_up",
            "Whether the store of snapshots works; NaN if there is none.",
            registry=registry,
        )
        self.snapshot_store_up.set(math.nan)  # no alert takes that for a store that is down
        self.parked = Gauge(
            "motiongen_sessions_parked", "Sessions that wait for a client that lost its connection.", registry=registry
        )
        self.dropped = Counter(
            "motiongen_frames_dropped", "Frames removed from a stream's queue unsent.", registry=registry
        )
        self.clips = Counter(
            "motiongen_clips", "Samples of clips requested, by the status of their call.", ["code"], registry=registry
        )
        self.clip_seconds = Histogram(
            "motiongen_clip_seconds", "Duration of calls for clips that were finished.", buckets=CLIP_BUCKETS,
            registry=registry,
        )  # fmt: skip
        self.streams = Gauge("motiongen_streams", "Open streams.", registry=registry)
        self.free_share = Gauge(
            "motiongen_free_share",
            "Share of the default model's capacity left for new sessions, 0 to 1; 0 while the server drains.",
            registry=registry,
        )
        self.other_servers = Gauge(
            "motiongen_other_servers",
            "Servers of the same Redis whose free room is known, to be named to clients that are refused; 8 at most.",
            registry=registry,
        )
        self.tasks = Gauge("motiongen_event_loop_tasks", "Tasks of the gateway's event loop.", registry=registry)
        self.gateway_lag = Gauge(
            "motiongen_gateway_lag_seconds",
            "How long messages wait for the gateway's event loop, the median over a second.",
            registry=registry,
        )
        self.queue_bytes = Gauge(
            "motiongen_outbound_queue_bytes",
            "Bytes held for all clients: to be sent, kept to be sent again, or received and not yet processed.",
            registry=registry,
        )
        self.heartbeat_age = Gauge(
            "motiongen_engine_heartbeat_age_seconds", "Time since the engine loop's last iteration.", registry=registry
        )
        self.engine_up = Gauge(
            "motiongen_engine_up", "Whether the engine process is there.", ["engine"], registry=registry
        )
        self.engine_restarts = Gauge(
            "motiongen_engine_restarts",
            "Engine processes started to replace lost ones.",
            ["engine"],
            registry=registry,
        )
        self.engine_memory = Gauge(
            "motiongen_engine_resident_memory_bytes", "Memory of an engine process.", ["engine"], registry=registry
        )
        ProcessCollector(registry=registry)

    def of_engine(self, model_id: str, engine: str) -> EngineMetrics:
        """The metrics of a model on an engine, exported from now on. From any thread."""
        return self._by_engine.of(model_id, engine)

    def watch_process(self, engine: str, process: WatchedProcess) -> None:
        """Export an engine process's state, read at every scrape."""
        self.engine_up.labels(engine).set_function(lambda: float(process.pid is not None))
        self.engine_restarts.labels(engine).set_function(lambda: process.num_restarts)
        self.engine_memory.labels(engine).set_function(lambda: process.rss_bytes)

    def watch_models(self, models: WatchedModels) -> None:
        """Export the state of the models that are offered, read at every scrape."""
        self._by_model.models = models
        self.free_share.set_function(lambda: models.free_share)

    def watch_service(self, service: WatchedService) -> None:
        """Export the state of streams and sessions, read at every scrape."""
        self._by_service.service = service
        self.streams.set_function(lambda: service.num_streams)
        self.parked.set_function(lambda: service.num_parked)
        self.queue_bytes.set_function(lambda: service.num_waiting_bytes)
        self.gateway_lag.set_function(lambda: service.gateway_lag_s)
        self.other_servers.set_function(lambda: service.num_other_servers)

    def watch_snapshots(self, writer: WatchedWriter) -> None:
        """Export the state of the snapshot writer, read at every scrape."""
        self.snapshot_lag.set_function(lambda: writer.lag_s)
        self.snapshot_store_up.set_function(lambda: float(not writer.is_failing))

    def forget_model(self, model_id: str) -> None:
        """Stop exporting the metrics of a model's engines."""
        self._by_engine.forget(model_id)

    def load_of(self, model_id: str) -> float:
        """The share of the machine that is committed, as a model's engines report it, on average."""
        return self._by_engine.load(model_id)

    def count_prompt(self, source: str) -> None:
        """Count a prompt that was not in memory. source: where it came from, or why it was refused."""
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
