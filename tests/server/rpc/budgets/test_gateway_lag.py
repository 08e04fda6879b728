"""The lag of the gateway's event loop: how it is measured, and that no session is admitted while it is too long."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Closed, CloseReason, Code, Open
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.replicas.hint import OtherServer
from motiongen_server.rpc.budgets.gateway_lag import LEAST_WRITES_HZ, LOOK_EVERY_S, MOST_LAG_S, GatewayLag
from motiongen_server.rpc.service import MotionService
from motiongen_server.rpc.streams.writer import write
from tests.server.rpc.streams.test_event_order import WALK, Engine, Line, Prompts, make_catalog
from tests.server.rpc.streams.test_stream_writer import Context
from tests.waiting import until_true


class Loop:
    """An event loop whose time the test moves."""

    def __init__(self) -> None:
        self.now = 100.0
        self.timers: list[tuple[float, Callable[[float], None], float]] = []

    def time(self) -> float:
        return self.now

    def call_at(self, when: float, callback: Callable[[float], None], argument: float) -> None:
        self.timers.append((when, callback, argument))

    def run(self, seconds: float, late_s: float) -> None:
        """Lets time pass; each timer that is due is called that much too late."""
        end = self.now + seconds
        while self.timers and self.timers[0][0] + late_s <= end:
            when, callback, argument = self.timers.pop(0)
            self.now = max(self.now, when + late_s)
            callback(argument)
        self.now = end


@pytest.fixture
def loop() -> Loop:
    return Loop()


def looking(loop: Loop, is_needed: Callable[[], bool] = lambda: True) -> GatewayLag:
    lag = GatewayLag(is_needed, loop)  # type: ignore[arg-type]
    lag.begin()
    return lag


def test_loop_that_keeps_up_has_no_lag_to_speak_of(loop: Loop) -> None:
    lag = looking(loop)
    assert lag.lag_s == 0.0
    loop.run(5.0, 0.004)
    assert lag.lag_s == pytest.approx(0.004)
    assert not lag.is_too_long


def run_busily(loop: Loop, lag: GatewayLag, seconds: float, writes_hz: float, write_s: float, late_s: float) -> None:
    """Notes that many writes a second, each of which takes `write_s`, while timers are late by `late_s`."""
    for _ in range(round(seconds / LOOK_EVERY_S)):
        for _ in range(round(writes_hz * LOOK_EVERY_S)):
            lag.note_write(write_s)
        loop.run(LOOK_EVERY_S, late_s)


BUSY_HZ = 1.5 * LEAST_WRITES_HZ


def test_single_pause_does_not_count_as_lag(loop: Loop) -> None:
    lag = looking(loop)
    run_busily(loop, lag, 5.0, BUSY_HZ, 0.001, 0.0)
    loop.run(0.5, 0.4)
    assert not lag.is_too_long


@pytest.mark.parametrize("late_s", [0.15, 0.6])
def test_lasting_lag_is_too_long_until_the_loop_has_caught_up(loop: Loop, late_s: float) -> None:
    lag = looking(loop)
    run_busily(loop, lag, 5.0, BUSY_HZ, 0.001, 0.0)
    run_busily(loop, lag, 5.0, BUSY_HZ, 0.001, late_s)
    assert lag.lag_s == pytest.approx(late_s)
    assert lag.is_too_long
    run_busily(loop, lag, 2.5, BUSY_HZ, 0.001, 0.0)
    assert not lag.is_too_long


def test_lag_of_a_loop_with_few_writes_is_not_too_long(loop: Loop) -> None:
    """A few more messages delay nobody then, and a server on a busy machine would be closed for nothing."""
    lag = looking(loop)
    run_busily(loop, lag, 5.0, 0.5 * LEAST_WRITES_HZ, 0.2, 0.3)
    assert lag.lag_s == pytest.approx(0.3)
    assert not lag.is_too_long


@pytest.mark.parametrize("others_s", [0.2, 30.0])
def test_shortest_write_shows_what_waits_inside_grpc(loop: Loop, others_s: float) -> None:
    """Timers are on time even so: the loop takes one event of gRPC per iteration, and thousands may wait."""
    lag = looking(loop)
    for _ in range(20):
        lag.note_write(others_s)
        run_busily(loop, lag, LOOK_EVERY_S, BUSY_HZ, 0.2, 0.0)
    assert lag.is_too_long
    for _ in range(20):
        lag.note_write(0.001)
        run_busily(loop, lag, LOOK_EVERY_S, BUSY_HZ, others_s, 0.0)
    assert not lag.is_too_long, "long writes beside a short one are those of slow readers, which delay nobody"
    loop.run(2.5, 0.0)
    assert lag.lag_s == 0.0, "earlier writes say nothing about the present"


async def test_every_written_message_is_noted() -> None:
    line = Line(make_catalog())
    noted: list[float] = []
    lag = Late(0.0)
    lag.note_write = noted.append  # type: ignore[method-assign]
    line.stream.gateway_lag = lag
    line.open()
    context = Context()
    writing = asyncio.create_task(write(line.stream, context))  # type: ignore[arg-type]
    await until_true(lambda: not context.messages.empty())
    line.stream.close_all(CloseReason.CLIENT)
    line.stream.take(Closed(line.engine.events[0].session, CloseReason.CLIENT, Code.OK, "", 0, 0))
    line.stream.end()
    await writing
    assert len(noted) == context.messages.qsize() >= 2
    assert min(noted) >= 0.0


def test_no_timer_runs_while_no_measurement_is_needed(loop: Loop) -> None:
    needed = [True]
    lag = looking(loop, lambda: needed[0])
    loop.run(1.0, 0.0)
    needed[0] = False
    loop.run(1.0, 0.0)
    assert not loop.timers
    loop.run(60.0, 0.0)
    lag.begin()
    lag.begin()
    assert [when for when, *_ in loop.timers] == [pytest.approx(loop.now + LOOK_EVERY_S)]
    loop.run(1.0, 0.01)
    assert lag.lag_s == pytest.approx(0.01)


class Late(GatewayLag):
    """A lag of as many seconds as the test says."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    @property
    def lag_s(self) -> float:
        return self._seconds

    @property
    def is_too_long(self) -> bool:
        return self._seconds > MOST_LAG_S


async def test_no_session_is_admitted_while_the_lag_is_too_long() -> None:
    line = Line(make_catalog())
    line.open()
    line.stream.gateway_lag = Late(2 * MOST_LAG_S)
    line.stream.other_servers = lambda model_id: (OtherServer("b:50051", ""),)
    second = session_pb2.SessionEvent(session=9, event_seq=1, open=session_pb2.OpenSession(prompts=WALK.upsert))
    line.stream.receive(second, 0.0)
    (told,) = [update.outcome for update in line.updates() if update.session == 9]
    assert (told.code, told.reason, told.field) == (Code.RESOURCE_EXHAUSTED, "OVERLOADED", "open")
    assert "100 ms" in told.message
    assert told.retry_after.seconds > 0
    assert [each.address for each in told.other_servers] == ["b:50051"]
    assert line.engine.kinds() == [Open], "the engine is not asked"
    assert await line.texts_asked() == []
    assert (line.stream.num_sessions, line.stream.peer.num_sessions) == (1, 1)
    line.send(2, set_play_state=session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED))
    assert len(line.engine.events) == 2, "a session that was admitted is served"
    line.stream.gateway_lag = Late(0.5 * MOST_LAG_S)
    line.stream.receive(session_pb2.SessionEvent(session=9, event_seq=1, open=session_pb2.OpenSession()), 0.0)
    assert line.stream.num_sessions == 2


class Roomy(Engine):
    free_share = 0.75


async def test_server_reports_no_free_capacity_while_the_lag_is_too_long(monkeypatch: pytest.MonkeyPatch) -> None:
    models = ModelRegistry(LoadedModel("fake", Roomy(), Prompts(), make_catalog()))  # type: ignore[arg-type]
    MotionService(models)
    assert models.free_share == 0.75
    monkeypatch.setattr(GatewayLag, "is_too_long", True)
    assert models.free_share == 0.0
    assert set(models.free_shares.values()) == {0.0}
    assert models.catalog_response("").free_share == 0.0
