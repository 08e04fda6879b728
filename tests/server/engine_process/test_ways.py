"""Inlet and outlet over real sockets: order, bounds, and a gateway that does not read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import zmq

from motiongen_server.config import ServerConfig
from motiongen_server.engine.scheduling.report import StepReport
from motiongen_server.engine.types import Chunk, Playhead
from motiongen_server.engine_process.codec import CodecError
from motiongen_server.engine_process.inlet import Inlet
from motiongen_server.engine_process.messages import (
    TO_ENGINE,
    TO_GATEWAY,
    Begin,
    CloseAhead,
    Events,
    Outputs,
    Pulse,
    Stop,
    ToEngine,
    ToGateway,
)
from motiongen_server.engine_process.outlet import Outlet
from motiongen_server.engine_process.sockets import BACK_MESSAGES, EngineEnd, GatewayEnd
from motiongen_server.errors import SettingError
from tests.server.engine_process.audience import KEY, close, opening, play, playhead

WAIT_MS = 5000


@dataclass
class Ways:
    """Both ends, in this process."""

    gateway: GatewayEnd
    end: EngineEnd
    stops: list[None] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.outlet = Outlet(self.end.back)
        self.inlet = Inlet(self.end, self.outlet, lambda: self.stops.append(None))

    def tell(self, message: ToEngine, ahead: bool = False) -> None:
        (self.gateway.ahead if ahead else self.gateway.events).send(TO_ENGINE.encode(message))

    def hear(self) -> ToGateway | None:
        """The next message of the engine; None if none comes within a moment."""
        return TO_GATEWAY.decode(self.gateway.back.recv()) if self.gateway.back.poll(200) else None


@pytest.fixture
def ways() -> Iterator[Ways]:
    gateway = GatewayEnd()
    end = EngineEnd(gateway.folder)
    both = Ways(gateway, end)
    yield both
    both.inlet.close()
    gateway.close()
    end.close()


def chunk(number: int) -> Chunk:
    return Chunk(KEY, 1, number, np.zeros((20, 115), np.float32), 0)


def test_events_wake_the_engine_and_come_in_order(ways: Ways) -> None:
    ways.tell(Events(1, (opening(), play(2))))
    ways.tell(Events(3, (play(3),)))
    taken = []
    while len(taken) < 3:
        ways.inlet.wait(WAIT_MS / 1000)
        taken += ways.inlet.take_all()
    assert [event.event_seq for event in taken] == [1, 2, 3]


def test_a_close_and_the_stop_come_ahead(ways: Ways) -> None:
    ways.tell(Events(1, (opening(),)))
    ways.inlet.wait(WAIT_MS / 1000)
    assert len(ways.inlet.take_all()) == 1
    for message in (CloseAhead(close(2), 1, 1), Stop()):
        ways.tell(message, ahead=True)
    taken = []
    while not ways.stops:
        ways.inlet.wait(WAIT_MS / 1000)
        taken += ways.inlet.take_all()
    assert [event.event_seq for event in taken] == [2]


def test_an_event_from_within_is_taken_and_a_ring_ends_the_wait(ways: Ways) -> None:
    assert ways.inlet.put(play(2))
    ways.inlet.wait(WAIT_MS / 1000)
    assert [event.event_seq for event in ways.inlet.take_all()] == [2]
    ways.inlet.ring()
    ways.inlet.wait(1e6)
    assert ways.inlet.take_all() == []


@pytest.mark.parametrize("ahead", [False, True])
@pytest.mark.parametrize("data", [b"\xc1", b"", TO_ENGINE.encode(Begin(ServerConfig()))])
def test_what_does_not_belong_is_refused(ways: Ways, data: bytes, ahead: bool) -> None:
    (ways.gateway.ahead if ahead else ways.gateway.events).send(data)
    ways.inlet.wait(WAIT_MS / 1000)
    with pytest.raises(CodecError):
        ways.inlet.take_all()


def test_a_gateway_that_does_not_read_stops_the_events_and_loses_nothing(ways: Ways) -> None:
    number = 0
    while not ways.outlet.is_blocked or ways.end.back.poll(200, zmq.POLLOUT):  # ZeroMQ itself is still moving some
        ways.outlet.deliver([chunk(number)])
        number += 1
        assert number < 100 * BACK_MESSAGES, "what waits is not bounded"
    ways.outlet.observe(StepReport(rows=5))
    ways.tell(Events(1, (opening(), playhead(3))))
    ways.tell(CloseAhead(close(2), 1, 2), ahead=True)
    ways.tell(Stop(), ahead=True)
    while not ways.stops:
        ways.inlet.wait(WAIT_MS / 1000)
        assert ways.inlet.take_all() == [], "an event came in, though what it makes can go nowhere"
    heard: list[int] = []
    taken: list[object] = []
    while len(heard) < number or not taken:
        message = ways.hear()
        if isinstance(message, Outputs):
            heard += [output.first_frame for output in message.outputs if isinstance(output, Chunk)]
        taken += ways.inlet.take_all()
    assert heard == list(range(number))
    assert not any(isinstance(event, Playhead) for event in taken), "it was of a session that had been closed"
    ways.outlet.observe(StepReport())
    pulse = ways.hear()
    assert isinstance(pulse, Pulse)
    assert [report.rows for report in pulse.reports] == [5, 0]


def test_a_folder_whose_path_is_too_long_is_said_to_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    with pytest.raises(SettingError, match="TMPDIR"):
        GatewayEnd()
    assert list(folder.iterdir()) == []
