"""An event loop that has no time: what is seen of it, and who is let in then."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Code, Open
from motiongen_server.models.registry import LoadedModel, ModelRegistry
from motiongen_server.replicas.hint import OtherServer
from motiongen_server.rpc.loop_lag import LOOK_EVERY_S, MOST_LAG_S, LoopLag
from motiongen_server.rpc.service import MotionService
from tests.server.rpc.test_event_order import WALK, Engine, Line, Prompts, make_catalog


class Loop:
    """An event loop whose time passes as the test says."""

    def __init__(self) -> None:
        self.now = 100.0
        self.timers: list[tuple[float, Callable[[float], None], float]] = []

    def time(self) -> float:
        return self.now

    def call_at(self, when: float, callback: Callable[[float], None], argument: float) -> None:
        self.timers.append((when, callback, argument))

    def run(self, seconds: float, late_s: float) -> None:
        """What is due in these seconds happens so much later."""
        end = self.now + seconds
        while self.timers and self.timers[0][0] + late_s <= end:
            when, callback, argument = self.timers.pop(0)
            self.now = max(self.now, when + late_s)
            callback(argument)
        self.now = end


@pytest.fixture
def loop() -> Loop:
    return Loop()


def looking(loop: Loop, is_needed: Callable[[], bool] = lambda: True) -> LoopLag:
    lag = LoopLag(is_needed, loop)  # type: ignore[arg-type]
    lag.begin()
    return lag


def test_a_loop_that_has_time_is_not_late(loop: Loop) -> None:
    lag = looking(loop)
    assert lag.lag_s == 0.0
    loop.run(5.0, 0.004)
    assert lag.lag_s == pytest.approx(0.004)
    assert not lag.is_too_long


def test_one_pause_is_not_taken_for_a_loop_without_time(loop: Loop) -> None:
    lag = looking(loop)
    loop.run(5.0, 0.0)
    loop.run(1.0, 0.9)
    assert not lag.is_too_long


@pytest.mark.parametrize("late_s", [0.15, 0.9])
def test_a_loop_that_stays_late_is_late_until_it_has_caught_up(loop: Loop, late_s: float) -> None:
    lag = looking(loop)
    loop.run(5.0, 0.0)
    loop.run(5.0, late_s)
    assert lag.lag_s == pytest.approx(late_s)
    assert lag.is_too_long
    loop.run(2.5, 0.0)
    assert not lag.is_too_long


def test_nothing_is_looked_at_while_there_is_nothing_to_be_late_for(loop: Loop) -> None:
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


class Late(LoopLag):
    """As late as the test says."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds

    @property
    def lag_s(self) -> float:
        return self._seconds


async def test_no_session_is_opened_where_those_that_are_open_wait_already() -> None:
    line = Line(make_catalog())
    line.open()
    line.stream.loop_lag = Late(2 * MOST_LAG_S)
    line.stream.other_servers = lambda model_id: (OtherServer("b:50051", ""),)
    second = session_pb2.SessionEvent(session=9, event_seq=1, open=session_pb2.OpenSession(prompts=WALK.upsert))
    line.stream.receive(second, 0.0)
    (told,) = [update.outcome for update in line.updates() if update.session == 9]
    assert (told.code, told.reason, told.field) == (Code.RESOURCE_EXHAUSTED, "OVERLOADED", "open")
    assert "200 ms" in told.message
    assert told.retry_after.seconds > 0
    assert [each.address for each in told.other_servers] == ["b:50051"]
    assert line.engine.kinds() == [Open], "the engine is not asked"
    assert line.prompts.asked == []
    assert (line.stream.num_sessions, line.stream.peer.num_sessions) == (1, 1)
    line.send(2, set_play_state=session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED))
    assert len(line.engine.events) == 2, "who is let in is served"
    line.stream.loop_lag = Late(0.5 * MOST_LAG_S)
    line.stream.receive(session_pb2.SessionEvent(session=9, event_seq=1, open=session_pb2.OpenSession()), 0.0)
    assert line.stream.num_sessions == 2


class Roomy(Engine):
    free_share = 0.75


async def test_a_server_whose_loop_is_late_tells_of_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    models = ModelRegistry(LoadedModel("fake", Roomy(), Prompts(), make_catalog()))  # type: ignore[arg-type]
    MotionService(models)
    assert models.free_share == 0.75
    monkeypatch.setattr(LoopLag, "lag_s", 2 * MOST_LAG_S)
    assert models.free_share == 0.0
    assert set(models.free_shares.values()) == {0.0}
    assert models.catalog_response("").free_share == 0.0
