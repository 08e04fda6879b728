"""An engine process's side of real sockets: order, limits, invalid messages, and a gateway that does not read."""

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
from motiongen_server.engine.types import Chunk, Code, Event, Outcome
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
from tests.waiting import LIMIT_S, until

WAIT_MS = int(1000 * LIMIT_S)


class Notebook:
    """Stands in for an engine: notes the events that it is given, and refuses event number 13."""

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
    """The socket back to the gateway. is_shut: it takes nothing, as if the gateway did not read."""

    def __init__(self, socket: zmq.Socket[bytes]) -> None:
        self._socket = socket
        self.is_shut = False

    def send(self, data: bytes, flags: int = 0) -> None:
        if self.is_shut:
            raise zmq.Again
        self._socket.send(data, flags)


class Process:
    """Both ends of the sockets and a host, within this process."""

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
            raise SettingError(source + "\udcff")  # kept out of log and reports, which cannot hold it
        if source == "unspeakable":
            return Built(self.unspeakable, FACTS, "\ud800")  # type: ignore[arg-type]
        return Built(self.engine, FACTS, "CC0-1.0")  # type: ignore[arg-type]

    def tell(self, message: ToEngine) -> None:
        (self.gateway.events if isinstance(message, Events) else self.gateway.ahead).send(TO_ENGINE.encode(message))

    def hear(self, patience_ms: int = WAIT_MS) -> ToGateway | None:
        """The next message to the gateway; None if none comes."""
        return TO_GATEWAY.decode(self.gateway.back.recv()) if self.gateway.back.poll(patience_ms) else None

    def hear_chunks(self, count: int) -> list[int]:
        """The first frames of the next chunks, in the order of their arrival."""
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


def test_events_arrive_in_order_and_a_close_before_those_it_overtook(process: Process) -> None:
    process.load()
    process.tell(Events(1, 1, (opening(), play(2))))
    assert seqs(process.engine.wait_for(2)) == [1, 2]
    process.tell(CloseAhead(1, close(9), 1, 4))
    process.engine.wait_for(3)
    process.tell(Events(1, 3, (play(3), play(4))))  # the close has overtaken these; the gateway answers them
    process.tell(Events(1, 5, (opening(),)))
    assert seqs(process.engine.wait_for(4)) == [1, 2, 9, 1]


def test_event_that_the_engine_refuses_is_answered_at_once(process: Process) -> None:
    process.load()
    process.tell(Events(1, 1, (play(13),)))
    message = process.hear()
    assert isinstance(message, Outputs)
    (outcome,) = message.outputs
    assert isinstance(outcome, Outcome)
    assert (message.slot, outcome.reason) == (1, "UNLUCKY")


def test_slots_are_loaded_and_unloaded_and_late_events_for_them_dropped(process: Process) -> None:
    process.load()
    process.tell(Load(2, "unsound"))
    assert process.hear() == Unloaded(2, "it is unsound", is_setting=True)
    process.tell(Unload(1))
    assert process.hear() == Unloaded(1)
    process.tell(Events(1, 1, (opening(),)))
    process.tell(Stop())
    assert process.ended() is None
    assert process.engine.taken == []


def test_model_whose_facts_cannot_be_sent_is_refused_and_others_play_on(process: Process) -> None:
    process.load()
    assert process.unspeakable.device.num_seats == 1
    process.tell(Load(2, "unspeakable"))
    told = process.hear()
    assert isinstance(told, Unloaded)
    assert (told.slot, told.is_setting, "what the model's folder says of it" in told.error) == (2, True, True)
    assert process.unspeakable.device.num_seats == 0, "it has no lease on the device any more"
    process.tell(Load(3, "odd name: "))
    assert process.hear() == Unloaded(3, "odd name: \\udcff", is_setting=True), "escaped, so that it can be sent"
    process.tell(Events(1, 1, (opening(),)))
    assert seqs(process.engine.wait_for(1)) == [1]


def test_texts_are_encoded_and_failures_are_answered(process: Process) -> None:
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
def test_invalid_message_ends_the_process(process: Process, data: bytes, way: str) -> None:
    getattr(process.gateway, way).send(data)
    assert isinstance(process.ended(), CodecError)


def test_output_for_a_gateway_that_does_not_read_is_limited_and_in_order(process: Process) -> None:
    process.load()
    outlet = Outlet(process.wire, 1)
    number = 0
    while not process.wire.is_blocked:
        outlet.deliver([chunk(number)])
        number += 1
        assert number < 100 * BACK_MESSAGES, "waiting output is not limited"
    assert process.hear_chunks(number) == list(range(number))


def test_events_wait_and_no_output_is_lost_while_the_gateway_does_not_read(process: Process) -> None:
    process.load()
    outlet = Outlet(process.wire, 1)
    process.back.is_shut = True
    for number in range(3):
        outlet.deliver([chunk(number)])
    outlet.observe(StepReport(rows=5))
    process.tell(Events(1, 1, (opening(), playhead(3))))
    process.tell(CloseAhead(1, close(2), 1, 2))
    process.tell(Load(2, "unsound"))
    until(lambda: len(process.wire._unsent) == 4)  # once that is answered, what came before has been read
    assert process.engine.taken == [], "an event was taken although its output has nowhere to go"
    process.back.is_shut = False
    assert process.hear_chunks(3) == [0, 1, 2]
    process.tell(Events(1, 3, (opening(),)))
    assert seqs(process.engine.wait_for(3)) == [1, 2, 1], "no playhead of a session that had been closed"
    pulse: ToGateway | None = None
    for _ in range(100):
        outlet.observe(StepReport())
        pulse = process.hear(100)
        if isinstance(pulse, Pulse):
            break
    assert isinstance(pulse, Pulse)
    assert [report.rows for report in pulse.reports[:2]] == [5, 0]


def test_close_that_overtook_its_open_reaches_the_engine_after_it(process: Process) -> None:
    process.load()
    process.tell(CloseAhead(1, close(2), 1, 1))
    process.tell(Events(1, 1, (opening(),)))
    assert seqs(process.engine.wait_for(2)) == [1, 2]


def test_temporary_folder_with_too_long_a_path_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / ("x" * 120)
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    with pytest.raises(SettingError, match="TMPDIR"):
        GatewayEnd()
    assert list(folder.iterdir()) == []
