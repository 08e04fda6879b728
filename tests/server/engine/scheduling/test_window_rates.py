"""What a session of each class is expected to ask for."""

import pytest

from motiongen_server.engine.scheduling.window_rates import WindowRates
from motiongen_server.engine.types import Priority


def _seen(windows: int, sessions: int, seconds: float = 20.0) -> WindowRates:
    rates = WindowRates(0.5)
    for _ in range(round(seconds / 0.25)):
        for _ in range(windows):
            rates.note(Priority.HERO)
        rates.update(0.25, {Priority.HERO: sessions})
    return rates


def test_until_something_is_seen_a_session_only_plays_on() -> None:
    rates = WindowRates(0.5)
    rates.update(0.25, {})
    assert [rates[priority] for priority in Priority] == [0.5] * 4


def test_a_class_that_is_steered_is_expected_to_be_steered() -> None:
    rates = _seen(windows=5, sessions=2)
    assert rates[Priority.HERO] == pytest.approx(10.0, rel=0.05)
    assert rates[Priority.CROWD] == 0.5


def test_what_was_seen_outlives_the_sessions_and_yields_to_what_others_do() -> None:
    rates = _seen(windows=5, sessions=2)
    for _ in range(100):
        rates.update(0.25, {Priority.HERO: 0})
    assert rates[Priority.HERO] > 9
    for _ in range(100):
        rates.update(0.25, {Priority.HERO: 4})
    assert rates[Priority.HERO] == 0.5
