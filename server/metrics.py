"""Every Prometheus metric, declared once. No label names a session or a prompt."""

from __future__ import annotations

from collections.abc import Mapping

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram

from server.engine.report import StepReport
from server.engine.types import Code, PlayState, Priority

LATENCY_BUCKETS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.075, 0.1, 0.15, 0.25, 0.5, 1.0, 2.5)
STEP_BUCKETS = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
ROW_BUCKETS = (1, 2, 4, 8, 16, 32, 64, 128)


class Metrics:
    """The server's metrics, in a registry of their own."""

    def __init__(self) -> None:
        registry = CollectorRegistry()
        self.registry = registry
        self.build = Gauge("motiongen_build_info", "What runs, always 1.", ["model", "rig"], registry=registry)
        self.sessions = Gauge("motiongen_sessions", "Open sessions.", ["class", "state"], registry=registry)
        self.opens = Counter("motiongen_session_opens", "Sessions asked for, by answer.", ["code"], registry=registry)
        self.closes = Counter("motiongen_session_closes", "Sessions ended, by reason.", ["reason"], registry=registry)
        self.windows = Counter("motiongen_windows", "Windows accepted.", ["class", "cause"], registry=registry)
        self.discarded = Counter("motiongen_windows_discarded", "Windows that came too late.", registry=registry)
        self.restarted = Counter("motiongen_windows_restarted", "Windows an edit started anew.", registry=registry)
        self.frames = Counter("motiongen_frames_sent", "Frames handed to streams.", registry=registry)
        self.superseded = Counter("motiongen_frames_superseded", "Frames an edit replaced.", registry=registry)
        self.deadlines = Counter("motiongen_deadlines", "Windows with a deadline.", ["class"], registry=registry)
        self.misses = Counter("motiongen_deadline_misses", "Windows finished late.", ["class"], registry=registry)
        self.underruns = Counter(
            "motiongen_client_underruns", "Underruns that clients report.", ["class"], registry=registry
        )
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
            "Playback that clients hold when they report.",
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
        self.prompt_seconds = Histogram(
            "motiongen_prompt_encode_seconds",
            "Encoding a prompt that was not in the cache.",
            buckets=LATENCY_BUCKETS,
            registry=registry,
        )
        self.nan_rows = Counter("motiongen_nan_rows", "Rows that turned to NaN or infinity.", registry=registry)
        self.faults = Counter("motiongen_runner_faults", "Calls of the model that failed.", registry=registry)
        self.heartbeat_age = Gauge(
            "motiongen_engine_heartbeat_age_seconds", "Since the engine's loop last went round.", registry=registry
        )
        self._set_sessions({})

    def observe(self, report: StepReport) -> None:
        """Count what one engine step did; called on the engine's thread."""
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
        self.nan_rows.inc(report.nan_rows)
        self.faults.inc(report.runner_faults)
        self._count_sessions(report)

    def _count_sessions(self, report: StepReport) -> None:
        for code in report.opens:
            self.opens.labels(Code(code).name).inc()
        for reason in report.closes:
            self.closes.labels(reason.name).inc()
        if report.sessions is not None:
            self._set_sessions(report.sessions)

    def _set_sessions(self, counts: Mapping[tuple[Priority, PlayState], int]) -> None:
        # All of them, 0 too: a series that comes and goes makes gaps, and clearing first would race with a scrape.
        for priority in Priority:
            for state in PlayState:
                self.sessions.labels(priority.name, state.name).set(counts.get((priority, state), 0))
