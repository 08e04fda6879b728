import math

from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.timers import Timers
from motiongen_server.engine.types import SessionKey

ONE, TWO = SessionKey(1, 1), SessionKey(1, 2)


def test_sessions_are_woken_once_at_the_earliest_time_they_asked_for() -> None:
    timers = Timers()
    timers.ask(ONE, 5.0)
    timers.ask(ONE, 3.0)
    timers.ask(ONE, 9.0)
    timers.ask(TWO, 4.0)
    timers.ask(TWO, math.inf)
    assert timers.next_at() == 3.0
    assert timers.due(2.9) == []
    assert timers.due(4.0) == [ONE, TWO]
    assert timers.due(100.0) == []
    assert timers.next_at() == math.inf


def test_forgotten_session_is_not_woken() -> None:
    timers = Timers()
    timers.ask(ONE, 1.0)
    timers.forget(ONE)
    timers.forget(TWO)
    assert timers.due(2.0) == []
    timers.ask(ONE, 5.0)
    assert timers.due(5.0) == [ONE]


@given(st.lists(st.tuples(st.integers(0, 9), st.floats(0, 100)), max_size=200), st.floats(0, 100))
def test_due_gives_exactly_the_sessions_whose_earliest_time_has_come(asks: list[tuple[int, float]], now: float) -> None:
    timers = Timers()
    earliest: dict[SessionKey, float] = {}
    for handle, at in asks:
        key = SessionKey(1, handle)
        timers.ask(key, at)
        earliest[key] = min(at, earliest.get(key, math.inf))
    assert sorted(timers.due(now)) == sorted(key for key, at in earliest.items() if at <= now)


def test_requests_for_ever_earlier_times_do_not_accumulate() -> None:
    timers = Timers()
    for number in range(100_000):
        timers.ask(SessionKey(1, number % 10), 1e6 - number)
    assert len(timers) < 200
    assert len(timers.due(1e6)) == 10
