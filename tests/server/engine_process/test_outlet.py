"""The way out of an engine process: what waits for the gateway, and how often steps are reported."""

from __future__ import annotations

import time

import numpy as np
import pytest
import zmq

from motiongen_server.engine.types import Chunk
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process import outlet as outlet_module
from motiongen_server.engine_process.messages import TO_GATEWAY, Outputs, Pulse
from motiongen_server.engine_process.outlet import PULSE_EVERY_S, Outlet, Wire
from motiongen_server.engine_process.sockets import LAST_WORDS_MS
from tests.server.engine_process.audience import KEY

SLOT = 7
CHUNK = Chunk(KEY, 1, 0, np.zeros((4, 3), np.float32), 0)


class Socket:
    """Takes so many messages, then no more until the test lets it; waits: how long it would wait for room, in ms."""

    def __init__(self) -> None:
        self.room = 1 << 20
        self.sent: list[bytes] = []
        self.waits: list[int] = []

    def send(self, data: bytes, flags: int = 0) -> None:
        if not self.room:
            raise zmq.Again
        assert flags == zmq.NOBLOCK or self.waits
        self.room -= 1
        self.sent.append(data)

    def setsockopt(self, option: int, value: int) -> None:
        assert option == zmq.SNDTIMEO
        self.waits.append(value)


class Way:
    """An outlet and its wire, at a time that the test tells. blocked: how often it was said to be blocked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.now_s)
        self.socket = Socket()
        self.wire = Wire(self.socket)  # type: ignore[arg-type]
        self.outlet = Outlet(self.wire, SLOT)
        self.blocked = 0
        self.wire.on_blocked = self._count

    def _count(self) -> None:
        self.blocked += 1

    def said(self) -> list[object]:
        return [TO_GATEWAY.decode(data) for data in self.socket.sent]

    def rows(self) -> list[list[int]]:
        """Of the reports in each pulse that was sent."""
        return [[report.rows for report in each.reports] for each in self.said() if isinstance(each, Pulse)]


@pytest.fixture
def way(monkeypatch: pytest.MonkeyPatch) -> Way:
    return Way(monkeypatch)


def test_reports_are_sent_in_batches_at_most_at_the_allowed_pace(way: Way) -> None:
    for rows in (1, 2, 3):
        way.outlet.observe(StepReport(rows=rows))
        way.now_s += 0.49 * PULSE_EVERY_S
    assert way.rows() == [[1]]
    way.now_s += PULSE_EVERY_S
    way.outlet.observe(StepReport(rows=4))
    assert way.rows() == [[1], [2, 3, 4]]
    pulse = way.said()[-1]
    assert isinstance(pulse, Pulse)
    assert (pulse.slot, pulse.heartbeat_at) == (SLOT, way.now_s)


def test_newest_reports_are_kept_while_the_gateway_does_not_read(way: Way, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlet_module, "MOST_REPORTS", 3)
    outlet = Outlet(way.wire, SLOT)
    way.socket.room = 0
    way.outlet.deliver([CHUNK])
    for rows in range(5):
        outlet.observe(StepReport(rows=rows))
        way.now_s += PULSE_EVERY_S
    way.socket.room = 10
    way.wire.flush()
    assert way.rows() == []
    outlet.observe(StepReport(rows=5))
    assert way.rows() == [[3, 4, 5]]


def test_each_flush_reports_once_that_messages_wait(way: Way) -> None:
    for times in (1, 2):
        way.socket.room = 0
        way.outlet.deliver([CHUNK])
        way.outlet.deliver([])
        assert (way.wire.is_blocked, way.blocked) == (True, times)
        way.socket.room = 1
        way.wire.flush()
        assert (way.wire.is_blocked, way.blocked) == (True, times), "one of two was sent"
        way.socket.room = 1
        way.wire.flush()
        assert not way.wire.is_blocked
    said = way.said()
    assert all(isinstance(each, Outputs) and each.slot == SLOT for each in said)
    assert [len(each.outputs) for each in said if isinstance(each, Outputs)] == [1, 0, 1, 0]


def test_end_waits_for_waiting_messages_and_gives_up_after_a_time(way: Way) -> None:
    way.socket.room = 0
    for _ in range(3):
        way.outlet.deliver([CHUNK])
    way.socket.room = 2
    way.wire.finish()
    assert (len(way.said()), way.socket.waits) == (2, [LAST_WORDS_MS])
    way.socket.room = 2
    way.wire.finish()
    assert len(way.said()) == 3
