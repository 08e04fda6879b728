"""OpenTelemetry spans: one for each window, from the event that requested it to its first frame on the wire.

Needs `motiongen-server[tracing]`. Spans are exported on a thread of their own; if the collector is slow or down they
are dropped, and nothing waits for it.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from motiongen_server.addresses import proxy_options
from motiongen_server.collector import PLAIN, TLS
from motiongen_server.engine.types.tracing import WindowTrace
from motiongen_server.settings import SettingError

if TYPE_CHECKING:
    from opentelemetry.sdk.trace.export import SpanExporter

SPAN_NAME = "motiongen.window"
END_S = 2.0
"""How long the export of the remaining spans may take when the server ends."""


class WindowSpans:
    """Makes spans of windows' traces. From any thread. share: of the windows that become spans, 0 to 1."""

    def __init__(self, exporter: SpanExporter, share: float = 1.0) -> None:
        """Raises SettingError if OpenTelemetry is not installed."""
        try:
            from opentelemetry import trace
            from opentelemetry.sdk.resources import SERVICE_NAME, Resource
            from opentelemetry.sdk.trace import TracerProvider
            from opentelemetry.sdk.trace.export import BatchSpanProcessor
            from opentelemetry.sdk.trace.sampling import TraceIdRatioBased
        except ImportError as error:
            raise _not_installed() from error
        self._kind = trace.SpanKind.SERVER
        self._exporter = exporter
        resource = Resource.create({SERVICE_NAME: "motiongen-server"})
        self._provider = TracerProvider(sampler=TraceIdRatioBased(share), resource=resource, shutdown_on_exit=False)
        self._provider.add_span_processor(BatchSpanProcessor(exporter))
        self._tracer = self._provider.get_tracer("motiongen_server")
        # Spans have dates, sessions use the monotonic clock. Read once: setting the wall clock later moves no span.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()

    def record(self, window: WindowTrace) -> None:
        """Record a window that was sent, or that will not be."""
        timing = window.timing
        span = self._tracer.start_span(
            SPAN_NAME,
            kind=self._kind,
            start_time=self._date(timing.asked_at),
            attributes={
                "motiongen.session": window.session,
                "motiongen.request_id": window.request_id,
                "motiongen.model": window.model_id,
                "motiongen.engine": timing.engine,
                "motiongen.plan": window.plan,
                "motiongen.cause": window.cause.name,
                "motiongen.first_frame": window.first_frame,
                "motiongen.num_events": window.num_events,
                "motiongen.num_steps": timing.num_steps,
                "motiongen.sent": window.is_sent,
            },
        )
        if span.is_recording():
            span.add_event("scheduled", timestamp=self._date(timing.created_at))
            span.add_event("first step", timestamp=self._date(timing.begun_at))
            span.add_event("planned", timestamp=self._date(timing.landed_at))
        span.end(self._date(window.sent_at))

    def close(self) -> None:
        """Export the remaining spans, for `END_S` at most, and end."""
        # By itself the library retries for half a minute if the collector is down.
        giving_up = threading.Timer(END_S, self._exporter.shutdown)
        giving_up.start()
        try:
            self._provider.shutdown()
        finally:
            giving_up.cancel()

    def _date(self, monotonic_s: float) -> int:
        """Nanoseconds since 1970."""
        return self._epoch_ns + round(monotonic_s * 1e9)


def open_window_spans(address: str, share: float) -> WindowSpans | None:
    """Spans that are exported to the collector at `address`; None if that is "". Raises SettingError."""
    if not address:
        return None
    try:
        from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter
    except ImportError as error:
        raise _not_installed() from error
    is_plain = address.startswith(PLAIN)
    endpoint = address.removeprefix(PLAIN if is_plain else TLS)
    options = proxy_options(endpoint)
    exporter = OTLPSpanExporter(endpoint=endpoint, insecure=is_plain, channel_options=options)  # type: ignore[arg-type]
    return WindowSpans(exporter, share)


def _not_installed() -> SettingError:
    return SettingError("trace_to needs OpenTelemetry; install motiongen-server[tracing], or leave trace_to out")
