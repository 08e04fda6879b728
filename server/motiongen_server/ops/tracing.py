"""Windows as OpenTelemetry spans: one each, from the event that asked for it to its first frame on the wire.

Needs `motiongen-server[tracing]`. Spans leave on a thread of their own; where the collector is away or slow they are
dropped, and nobody waits.
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
"""That spans which have not left may take once the server ends."""


class WindowSpans:
    """Takes traces of windows, on any thread. share: of them that become spans, 0 to 1."""

    def __init__(self, exporter: SpanExporter, share: float = 1.0) -> None:
        """Raises SettingError where OpenTelemetry is not installed."""
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
        # Traces have dates, sessions go by the monotonic clock; a wall clock that is set later moves no span.
        self._epoch_ns = time.time_ns() - time.monotonic_ns()

    def record(self, window: WindowTrace) -> None:
        """A window was sent, or will not be."""
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
        """Send what there is, for a moment, and end."""
        # By itself the library tries again for half a minute where the collector is away.
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
    """To the collector of the setting; None where there is none. Raises SettingError."""
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
