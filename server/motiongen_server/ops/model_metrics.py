"""The metrics of engines, kept separately for each model and engine, and exported with both as labels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from typing import TypeVar

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, Metric
from prometheus_client.registry import Collector
from prometheus_client.samples import Sample

from motiongen_server.engine.ports import Observe
from motiongen_server.engine.types import Code, PlayState, Priority, ServiceTier
from motiongen_server.engine.types.report import StepReport

T = TypeVar("T")

LATENCY_BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5)
STEP_BUCKETS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
ROW_BUCKETS = (1, 2, 4, 8, 16, 32, 64, 128)


class EngineMetrics:
    """The metrics of one engine for one model, in a registry of their own."""

    def __init__(self) -> None:
        registry = CollectorRegistry()
        self.registry = registry
        self.sessions = Gauge("motiongen_sessions", "Open sessions.", ["class", "state"], registry=registry)
        self.opens = Counter(
            "motiongen_session_opens", "Requests to open a session, by outcome.", ["code"], registry=registry
        )
        self.closes = Counter("motiongen_session_closes", "Sessions ended, by reason.", ["reason"], registry=registry)
        self.windows = Counter("motiongen_windows", "Windows accepted.", ["class", "cause"], registry=registry)
        self.discarded = Counter("motiongen_windows_discarded", "Windows that came too late.", registry=registry)
        self.restarted = Counter("motiongen_windows_restarted", "Windows restarted by an edit.", registry=registry)
        self.steps_discarded = Counter(
            "motiongen_steps_discarded", "Denoising steps, by rows, of windows that were not used.", registry=registry
        )
        self.frames = Counter("motiongen_frames_sent", "Frames handed to streams.", registry=registry)
        self.superseded = Counter("motiongen_frames_superseded", "Frames an edit replaced.", registry=registry)
        self.deadlines = Counter("motiongen_deadlines", "Windows with a deadline.", ["class"], registry=registry)
        self.misses = Counter("motiongen_deadline_misses", "Windows finished late.", ["class"], registry=registry)
        self.underruns = Counter(
            "motiongen_client_underruns", "Underruns that clients report.", ["class"], registry=registry
        )
        for priority in Priority:  # 0 from the beginning, so that rates and shares can be drawn
            for counter in (self.deadlines, self.misses, self.underruns):
                counter.labels(priority.name)
        self.first_frame = Histogram(
            "motiongen_event_first_frame_seconds",
            "From an event's arrival to the delivery of the first frame it changed.",
            ["class", "kind"],
            buckets=LATENCY_BUCKETS,
            registry=registry,
        )
        self.queue_wait = Histogram(
            "motiongen_queue_wait_seconds",
            "From a window's creation to its first step.",
            buckets=LATENCY_BUCKETS,
            registry=registry,
        )
        self.slack = Histogram(
            "motiongen_slack_seconds",
            "Playback time that clients hold when they report.",
            ["class"],
            buckets=(0.0, 0.1, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0),
            registry=registry,
        )
        self.step_seconds = Histogram(
            "motiongen_step_seconds",
            "One denoising step.",
            ["bucket"],
            buckets=STEP_BUCKETS,
            registry=registry,
        )
        self.prepare_seconds = Histogram(
            "motiongen_prepare_seconds", "Preparing new windows.", buckets=STEP_BUCKETS, registry=registry
        )
        self.decode_seconds = Histogram(
            "motiongen_decode_seconds", "Decoding finished windows.", buckets=STEP_BUCKETS, registry=registry
        )
        self.batch_rows = Histogram(
            "motiongen_batch_rows", "Rows in a denoising step.", buckets=ROW_BUCKETS, registry=registry
        )
        self.nan_rows = Counter("motiongen_nan_rows", "Rows that turned to NaN or infinity.", registry=registry)
        self.faults = Counter("motiongen_runner_faults", "Calls of the model that failed.", registry=registry)
        self.memory_splits = Counter(
            "motiongen_memory_splits", "Calls of the model split because memory was short.", registry=registry
        )
        self.soft_resets = Counter("motiongen_soft_resets", "Corrections of drifted characters.", registry=registry)
        self.held = Counter(
            "motiongen_frames_held", "Frames that repeat a pose because there was no window.", registry=registry
        )
        self.load = Gauge("motiongen_load", "Share of the machine committed, 1 being all of it.", registry=registry)
        self.tier = Gauge(
            "motiongen_service_tier", "Service of a class: 1 full, 2 fewer steps, 3 no guidance, 5 a held pose.",
            ["class"], registry=registry,
        )  # fmt: skip
        # By reporting engine: while a model is reloaded there are two, one of which has fewer and fewer sessions.
        self._sessions: dict[object, Mapping[tuple[Priority, PlayState], int]] = {}
        self._loads: dict[object, float] = {}
        self._tiers: dict[object, Mapping[Priority, ServiceTier]] = {}
        self._set_sessions()
        self._set_tiers()

    def observer(self) -> Observe:
        """A function that takes the reports of one engine; other engines may report too, each to its own."""
        return partial(self.observe, source=object())

    def observe(self, report: StepReport, source: object = None) -> None:
        """Count what one engine step did; called on the engine's thread. source: identifies the engine."""
        if report.rows:
            self.batch_rows.observe(report.rows)
            self.step_seconds.labels(str(report.bucket)).observe(report.step_seconds)
        if report.prepare_seconds:
            self.prepare_seconds.observe(report.prepare_seconds)
        if report.decode_seconds:
            self.decode_seconds.observe(report.decode_seconds)
        for wait in report.queue_waits:
            self.queue_wait.observe(wait)
        for priority, seconds in report.slacks:
            self.slack.labels(priority.name).observe(seconds)
        for priority in report.deadlines:
            self.deadlines.labels(priority.name).inc()
        for priority in report.deadline_misses:
            self.misses.labels(priority.name).inc()
        for priority, cause in report.windows:
            self.windows.labels(priority.name, cause.name).inc()
        for priority, count in report.client_underruns:
            self.underruns.labels(priority.name).inc(count)
        for latency in report.event_latencies:
            self.first_frame.labels(latency.priority.name, latency.kind).observe(latency.seconds)
        self.frames.inc(report.frames_sent)
        self.superseded.inc(report.frames_superseded)
        self.discarded.inc(report.windows_discarded)
        self.restarted.inc(report.windows_restarted)
        self.steps_discarded.inc(report.steps_discarded)
        self.nan_rows.inc(report.nan_rows)
        self.faults.inc(report.runner_faults)
        self.memory_splits.inc(report.memory_splits)
        self.soft_resets.inc(report.soft_resets)
        self.held.inc(report.frames_held)
        if report.load is not None:
            _put(self._loads, source, report.load, report.load > 0)
            self.load.set(max(self._loads.values(), default=0.0))
        if report.tiers is not None:
            _put(self._tiers, source, report.tiers, any(tier > ServiceTier.FULL for tier in report.tiers.values()))
            self._set_tiers()
        self._count_sessions(report, source)

    def _count_sessions(self, report: StepReport, source: object) -> None:
        for code in report.opens:
            self.opens.labels(Code(code).name).inc()
        for reason in report.closes:
            self.closes.labels(reason.name).inc()
        if report.sessions is not None:
            _put(self._sessions, source, report.sessions, any(report.sessions.values()))
            self._set_sessions()

    def _set_tiers(self) -> None:
        said = tuple(self._tiers.values())
        for priority in Priority:
            worst = max((tiers.get(priority, ServiceTier.FULL) for tiers in said), default=ServiceTier.FULL)
            self.tier.labels(priority.name).set(worst.value)

    def _set_sessions(self) -> None:
        # Also those that are 0: a series that comes and goes has gaps, and clearing first would race with a scrape.
        said = tuple(self._sessions.values())
        for priority in Priority:
            for state in PlayState:
                count = sum(counts.get((priority, state), 0) for counts in said)
                self.sessions.labels(priority.name, state.name).set(count)


def _put(said: dict[object, T], source: object, what: T, is_something: bool) -> None:
    """Keep an engine's last report, or remove it if there is nothing in it: the engine may be gone for good."""
    if is_something:
        said[source] = what
    else:
        said.pop(source, None)


class ByEngine(Collector):
    """The metrics of all models on all engines; each sample is labelled with its model and its engine."""

    def __init__(self) -> None:
        self._blank = EngineMetrics()
        self._engines: dict[tuple[str, str], EngineMetrics] = {}

    def of(self, model_id: str, engine: str) -> EngineMetrics:
        """The metrics of a model on an engine, exported from now on. From any thread."""
        return self._engines.setdefault((model_id, engine), EngineMetrics())

    def forget(self, model_id: str) -> None:
        """Stop exporting the metrics of a model."""
        for key in tuple(self._engines):
            if key[0] == model_id:
                self._engines.pop(key, None)

    def load(self, model_id: str) -> float:
        """The load that the engines of a model report, on average."""
        loads = [
            metrics.registry.get_sample_value("motiongen_load") or 0.0
            for key, metrics in tuple(self._engines.items())
            if key[0] == model_id
        ]
        return sum(loads) / max(1, len(loads))

    def describe(self) -> Iterable[Metric]:
        """All metrics, without samples."""
        return [_without_samples(family) for family in self._blank.registry.collect()]

    def collect(self) -> Iterable[Metric]:
        """All metrics, with the samples of every model on every engine."""
        whole = {family.name: family for family in self.describe()}
        for (model_id, engine), metrics in tuple(self._engines.items()):
            labels = {"model": model_id, "engine": engine}
            for family in metrics.registry.collect():
                whole[family.name].samples += [
                    Sample(each.name, {**labels, **each.labels}, each.value, each.timestamp, each.exemplar)
                    for each in family.samples
                ]
        return whole.values()


def _without_samples(family: Metric) -> Metric:
    return Metric(family.name, family.documentation, family.type, family.unit)
