"""An engine process's own side over real sockets: order, bounds, what does not belong, and a gateway that is deaf."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
import zmq

from motiongen_server.config import ServerConfig
from motiongen_server.engine.ports import Deliver, Inbox, Observe
from motiongen_server.engine.scheduling.device import Device
from motiongen_server.engine.types import Chunk, Close, Code, Event, Outcome, Playhead
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.codec import CodecError
from motiongen_server.engine_process.host import EngineHost
from motiongen_server.engine_process.messages import (
    TO_ENGINE,
    TO_GATEWAY,
    Begin,
    CloseAhead,
    Encoded,
    EncoderReady,
    EncodeTexts,
    Events,
    Load,
    LoadEncoder,
    Outputs,
    Pulse,
    Ready,
    Stop,
    ToEngine,
    ToGateway,
    Unload,
    Unloaded,
)
from motiongen_server.engine_process.outlet import Outlet, Wire
from motiongen_server.engine_process.slot import Built
from motiongen_server.engine_process.sockets import BACK_MESSAGES, EngineEnd, GatewayEnd
from motiongen_server.settings import SettingError
from tests.server.engine.fakes import FACTS
from tests.server.engine_process.audience import KEY, close, opening, play, playhead
from tests.server.engine_process.fake_engine import Stutterer
from tests.waiting import LIMIT_S

WAIT_MS = int(1000 * LIMIT_S)


class Notebook:
    """In the place of an engine: writes down what it is given, and refuses what has the event number 13."""

    observe = None
    num_sessions = 0

    def __init__(self) -> None:
        self.device = Device()
        self.lease = self.device.lease()
        self.taken: list[Event] = []
        self.came = threading.Condition()
        self.stopped = threading.Event()

    def submit(self, event: Event) -> Outcome | None:
        with self.came:
            self.taken.append(event)
            self.came.notify_all()
        return Outcome(event.session, 13, Code.CANCELLED, reason="UNLUCKY") if event.event_seq == 13 else None

    def wait_for(self, count: int) -> list[Event]:
        with self.came:
            assert self.came.wait_for(lambda: len(self.taken) >= count, WAIT_MS / 1000)
            return list(self.taken)

    @property
    def finished(self) -> bool:
        return self.stopped.is_set()

    def step(self) -> StepReport:
        return StepReport()

    def wait(self) -> None:
        self.stopped.wait()

    def end_drained(self) -> None:
        """It holds no sessions."""

    def stop(self) -> None:
        self.stopped.set()


class GatedSocket:
    """The way back to the gateway. is_shut: it takes nothing, as where the gateway does not read."""

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self.is_shut = False

    def send(self, data: bytes, flags: int = 0) -> None:
        if self.is_shut:
            raise zmq.Again
        self._socket.send(data, flags)


class Process:
    """Both ends and a host, in this process."""

    def __init__(self) -> None:
        self.gateway = GatewayEnd()
        self.end = EngineEnd(self.gateway.folder)
        self.back = GatedSocket(self.end.back)
        self.wire = Wire(self.back)  # type: ignore[arg-type]
        self.engine, self.unspeakable = Notebook(), Notebook()
        self.freed = threading.Event()
        self.host = EngineHost(self.end, self.wire, self._build, lambda width: Stutterer(), self.freed.set)
        self.result: list[BaseException | None] = []
        self.thread = threading.Thread(target=lambda: self.result.append(self.host.run()), daemon=True)
        self.thread.start()

    def _build(self, source: str, deliver: Deliver, observe: Observe, inbox: Inbox) -> Built:
        if source == "unsound":
            raise SettingError("it is unsound")
        if source.startswith("odd"):
            raise SettingError(source + "\udcff")  # which is not logged: no report of a test could hold it
        if source == "unspeakable":
            return Built(self.unspeakable, FACTS, "\ud800")  # type: ignore[arg-type]
        return Built(self.engine, FACTS, "CC0-1.0")  # type: ignore[arg-type]

    def tell(self, message: ToEngine) -> None:
        (self.gateway.events if isinstance(message, Events) else self.gateway.ahead).send(TO_ENGINE.encode(message))

    def hear(self, patience_ms: int = WAIT_MS) -> ToGateway | None:
        """The next message; None if none comes."""
        return TO_GATEWAY.decode(self.gateway.back.recv()) if self.gateway.back.poll(patience_ms) else None

    def hear_chunks(self, count: int) -> list[int]:
        """The first frames of so many chunks, as they come."""
        heard: list[int] = []
        while len(heard) < count:
            message = self.hear()
            assert message is not None, heard
            if isinstance(message, Outputs):
                heard += [output.first_frame for output in message.outputs if isinstance(output, Chunk)]
        return heard

    def load(self, slot: int = 1) -> None:
        self.tell(Load(slot, "fake"))
        self.hear_of(Ready)

    def hear_of(self, kind: type) -> object:
        """The next message of that kind."""
        while not isinstance(message := self.hear(), kind):
            assert message is not None
        return message

    def ended(self) -> BaseException | None:
        self.thread.join(WAIT_MS / 1000)
        assert not self.thread.is_alive()
        return self.result[0]


@pytest.fixture
def process() -> Iterator[Process]:
    both = Process()
    yield both
    if both.thread.is_alive():
        both.tell(Stop())
        while both.thread.is_alive():
            both.hear(10)
    both.end.close()
    both.gateway.close()


def seqs(events: Sequence[Event]) -> list[int]:
    return [event.event_seq for event in events]


def chunk(number: int) -> Chunk:
    return Chunk(KEY, 1, number, np.zeros((20, 115), np.float32), 0)


def test_events_come_in_order_and_a_close_ahead_of_those_it_has_overtaken(process: Process) -> None:
    process.load()
    process.tell(Events(1, 1, (opening(), play(2))))
    assert seqs(process.engine.wait_for(2)) == [1, 2]
    process.tell(CloseAhead(1, close(9), 1, 4))
    process.engine.wait_for(3)
    process.tell(Events(1, 3, (play(3), play(4))))  # these are answered by the gateway
    process.tell(Events(1, 5, (opening(),)))
    assert seqs(process.engine.wait_for(4)) == [1, 2, 9, 1]


def test_what_the_engine_refuses_is_answered_at_once(process: Process) -> None:
    process.load()
    process.tell(Events(1, 1, (play(13),)))
    message = process.hear()
    assert isinstance(message, Outputs)
    (outcome,) = message.outputs
    assert isinstance(outcome, Outcome)
    assert (message.slot, outcome.reason) == (1, "UNLUCKY")


def test_slots_are_loaded_and_unloaded_and_what_comes_late_for_one_is_dropped(process: Process) -> None:
    process.load()
    process.tell(Load(2, "unsound"))
    assert process.hear() == Unloaded(2, "it is unsound", is_setting=True)
    process.tell(Unload(1))
    assert process.hear() == Unloaded(1)
    process.tell(Events(1, 1, (opening(),)))
    process.tell(Stop())
    assert process.ended() is None
    assert process.engine.taken == []


def test_a_model_of_which_cannot_be_told_leaves_the_others_alone(process: Process) -> None:
    process.load()
    assert process.unspeakable.device.num_seats == 1
    process.tell(Load(2, "unspeakable"))
    told = process.hear()
    assert isinstance(told, Unloaded)
    assert (told.slot, told.is_setting, "what the model's folder says of it" in told.error) == (2, True, True)
    assert process.unspeakable.device.num_seats == 0, "it takes no turns on the device"
    process.tell(Load(3, "odd name: "))
    assert process.hear() == Unloaded(3, "odd name: \\udcff", is_setting=True), "spelled out, to be sent at all"
    process.tell(Events(1, 1, (opening(),)))
    assert seqs(process.engine.wait_for(1)) == [1]


def test_texts_are_encoded_and_one_that_cannot_be_is_answered_too(process: Process) -> None:
    process.tell(LoadEncoder(2))
    assert process.hear() == EncoderReady("length-1", 2, "")
    process.tell(EncodeTexts(7, ("abc",)))
    encoded = process.hear()
    assert isinstance(encoded, Encoded)
    assert (encoded.number, encoded.vectors.tolist(), encoded.error) == (7, [[3.0, 0.0]], "")
    process.tell(EncodeTexts(8, ("fail",)))
    failed = process.hear()
    assert isinstance(failed, Encoded)
    assert (failed.number, "out of words" in failed.error) == (8, True)


@pytest.mark.parametrize("way", ["events", "ahead"])
@pytest.mark.parametrize("data", [b"\xc1", b"", TO_ENGINE.encode(Begin(ServerConfig(), "cpu", 1, 1))])
def test_what_does_not_belong_ends_the_process(process: Process, data: bytes, way: str) -> None:
    getattr(process.gateway, way).send(data)
    assert isinstance(process.ended(), CodecError)


def test_what_waits_for_a_gateway_that_does_not_read_is_bounded_and_comes_in_order(process: Process) -> None:
    process.load()
    outlet = Outlet(process.wire, 1)
    number = 0
    while not process.wire.is_blocked:
        outlet.deliver([chunk(number)])
        number += 1
        assert number < 100 * BACK_MESSAGES, "what waits is not bounded"
    assert process.hear_chunks(number) == list(range(number))


def test_a_gateway_that_does_not_read_stops_the_events_and_loses_nothing(process: Process) -> None:
    process.load()
    outlet = Outlet(process.wire, 1)
    process.back.is_shut = True
    for number in range(3):
        outlet.deliver([chunk(number)])
    outlet.observe(StepReport(rows=5))
    process.tell(Events(1, 1, (opening(), playhead(3))))
    process.tell(CloseAhead(1, close(2), 1, 2))
    process.tell(Unload(1))
    process.engine.stopped.wait(WAIT_MS / 1000)
    assert process.engine.taken == [], "an event came in, though what it makes can go nowhere"
    process.back.is_shut = False
    assert process.hear_chunks(3) == [0, 1, 2]
    assert not any(isinstance(event, Playhead) for event in process.engine.taken), "its session had been closed"
    pulse: ToGateway | None = None
    for _ in range(100):
        outlet.observe(StepReport())
        pulse = process.hear(100)
        if isinstance(pulse, Pulse):
            break
    assert isinstance(pulse, Pulse)
    assert [report.rows for report in pulse.reports[:2]] == [5, 0]


def test_a_close_and_the_open_that_it_overtook_while_nothing_was_read(process: Process) -> None:
    process.load()
    process.tell(CloseAhead(1, close(2), 1, 1))
    process.tell(Events(1, 1, (opening(),)))
    taken = process.engine.wait_for(2)
    assert isinstance(taken[1], Close)


def test_a_folder_whose_path_is_too_long_is_said_to_be(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    with pytest.raises(SettingError, match="TMPDIR"):
        GatewayEnd()
    assert list(folder.iterdir()) == []
