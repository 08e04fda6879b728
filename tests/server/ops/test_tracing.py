"""Traces of windows as OpenTelemetry spans: kept in memory, sent to an OTLP collector, or to an address without one."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Sequence

import pytest
from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.trace import ReadableSpan
from opentelemetry.sdk.trace.export import SpanExporter, SpanExportResult
from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter

from motiongen_server.config import ServerConfig
from motiongen_server.engine.types import PlanCause
from motiongen_server.engine.types.tracing import WindowTiming, WindowTrace
from motiongen_server.ops import tracing
from motiongen_server.ops.tracing import WindowSpans, open_window_spans
from motiongen_server.settings import SettingError
from tests.server.ops.collector import Collector, attributes
from tests.waiting import LIMIT_S

BEGAN = 1000.0
WINDOW = WindowTrace(
    WindowTiming(BEGAN, BEGAN + 0.001, BEGAN + 0.002, BEGAN + 0.05, 4, "pid 7"),
    session="1-2-abc",
    request_id="guard",
    model_id="fake",
    plan=3,
    first_frame=40,
    cause=PlanCause.EDIT,
    num_events=2,
    sent_at=BEGAN + 0.06,
    is_sent=True,
)
ATTRIBUTES = {
    "motiongen.session": "1-2-abc",
    "motiongen.request_id": "guard",
    "motiongen.model": "fake",
    "motiongen.engine": "pid 7",
    "motiongen.plan": 3,
    "motiongen.cause": "EDIT",
    "motiongen.first_frame": 40,
    "motiongen.num_events": 2,
    "motiongen.num_steps": 4,
    "motiongen.sent": True,
}


def test_window_becomes_a_span_from_its_event_to_its_frames() -> None:
    exporter = InMemorySpanExporter()
    spans = WindowSpans(exporter)
    spans.record(WINDOW)
    spans.close()
    (span,) = exporter.get_finished_spans()
    assert span.name == "motiongen.window"
    assert dict(span.attributes or {}) == ATTRIBUTES
    assert span.start_time is not None
    assert span.end_time is not None
    assert span.end_time - span.start_time == pytest.approx(60e6, abs=1e3)  # nanoseconds
    after = {event.name: event.timestamp - span.start_time for event in span.events}
    assert after == {
        "scheduled": pytest.approx(1e6, abs=1e3),
        "first step": pytest.approx(2e6, abs=1e3),
        "planned": pytest.approx(50e6, abs=1e3),
    }
    assert span.parent is None


def test_span_times_are_dates_converted_from_the_monotonic_clock() -> None:
    """The offset of the two clocks is read before and after the conversion."""
    exporter = InMemorySpanExporter()
    before = time.time_ns() - time.monotonic_ns()
    spans = WindowSpans(exporter)
    after = time.time_ns() - time.monotonic_ns()
    spans.record(WINDOW)
    spans.close()
    (span,) = exporter.get_finished_spans()
    least, most = sorted((before, after))
    slack_ns = 1e6  # either clock may be read a moment later than the other
    assert span.start_time is not None
    assert least - slack_ns <= span.start_time - BEGAN * 1e9 <= most + slack_ns


@pytest.mark.parametrize(("share", "least", "most"), [(0.0, 0, 0), (0.25, 180, 320), (1.0, 1000, 1000)])
def test_share_of_the_windows_is_traced(share: float, least: int, most: int) -> None:
    exporter = InMemorySpanExporter()
    spans = WindowSpans(exporter, share)
    for _ in range(1000):
        spans.record(WINDOW)
    spans.close()
    assert least <= len(exporter.get_finished_spans()) <= most


def test_spans_are_sent_to_the_collector() -> None:
    with Collector() as collector:
        spans = open_window_spans(f"grpc:127.0.0.1:{collector.port}", 1.0)
        assert spans is not None
        for _ in range(3):
            spans.record(WINDOW)
        spans.close()
        assert len(collector.spans) == 3
        assert collector.service == "motiongen-server"
        assert attributes(collector.spans[0]) == ATTRIBUTES
        assert [event.name for event in collector.spans[0].events] == ["scheduled", "first step", "planned"]


def test_collector_on_this_machine_is_reached_without_the_proxy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.delenv("no_proxy", raising=False)
    with Collector() as collector:
        spans = open_window_spans(f"grpc:127.0.0.1:{collector.port}", 1.0)
        assert spans is not None
        spans.record(WINDOW)
        spans.close()
        assert len(collector.spans) == 1


def test_unreachable_collector_drops_spans_without_blocking(monkeypatch: pytest.MonkeyPatch) -> None:
    """More spans are recorded than the queue holds; some are dropped, and recording waits for no network call."""
    monkeypatch.setattr(tracing, "END_S", 0.1)
    exports: list[tuple[int, SpanExportResult]] = []
    export, are_recorded = OTLPSpanExporter.export, threading.Event()

    def noted(exporter: OTLPSpanExporter, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        assert are_recorded.wait(LIMIT_S)
        exports.append((len(spans), export(exporter, spans)))
        return exports[-1][1]

    monkeypatch.setattr(OTLPSpanExporter, "export", noted)
    with socket.socket() as nobody:
        nobody.bind(("127.0.0.1", 0))  # bound, but not listening
        spans = open_window_spans(f"grpc:127.0.0.1:{nobody.getsockname()[1]}", 1.0)
        assert spans is not None
        for _ in range(5000):
            spans.record(WINDOW)
        are_recorded.set()
        spans.close()
    assert {result for _, result in exports} == {SpanExportResult.FAILURE}
    assert 0 < sum(count for count, _ in exports) < 5000


class StuckExporter(SpanExporter):
    """Blocks in each export until it is shut down."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self.num_ends = 0

    def export(self, spans: Sequence[ReadableSpan]) -> SpanExportResult:
        assert self.ended.wait(LIMIT_S)
        return SpanExportResult.FAILURE

    def shutdown(self) -> None:
        self.num_ends += 1
        self.ended.set()


def test_close_gives_up_soon_on_a_stuck_export(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracing, "END_S", 0.1)
    exporter = StuckExporter()
    spans = WindowSpans(exporter)
    spans.record(WINDOW)
    spans.close()
    assert exporter.num_ends == 2, "once by us, before the library's own call"


def test_without_an_address_no_spans_are_opened() -> None:
    assert open_window_spans("", 1.0) is None


@pytest.mark.parametrize(
    "address",
    ["collector:4317", "http://collector:4317", "grpc:collector", "grpc::4317", "grpc:", "grpc:a:99999", "grpc:a:0"],
)
def test_invalid_address_is_refused(address: str) -> None:
    with pytest.raises(SettingError, match=r"trace_to is .* it must be grpc:HOST:PORT, or grpcs:HOST:PORT for TLS"):
        ServerConfig(trace_to=address)


def test_missing_library_is_reported_with_the_extra_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "opentelemetry.exporter.otlp.proto.grpc.trace_exporter", None)
    with pytest.raises(SettingError, match=r"install motiongen-server\[tracing\]"):
        open_window_spans("grpc:localhost:4317", 1.0)
