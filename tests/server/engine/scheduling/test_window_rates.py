"""How many windows a second a session of each class is expected to ask for."""

import pytest

from motiongen_server.engine.scheduling.window_rates import WindowRates
from motiongen_server.engine.types import Priority


def _seen(replans: int, sessions: int, seconds: float = 60.0) -> WindowRates:
    """Rates after so many replans in every quarter of a second."""
    rates = WindowRates(0.5)
    for _ in range(round(seconds / 0.25)):
        for _ in range(replans):
            rates.note_replan(Priority.HERO)
        rates.update(0.25, {Priority.HERO: sessions})
    return rates


def test_sessions_are_expected_to_be_edited_before_any_observation() -> None:
    rates = WindowRates(0.5)
    rates.update(0.25, {})
    assert [rates[priority] for priority in Priority] == [1.5, 0.8, 0.7, 0.6]


def test_rate_of_a_steered_class_follows_its_replans() -> None:
    rates = _seen(replans=25, sessions=10)
    assert rates[Priority.HERO] == pytest.approx(10.5, rel=0.15)
    assert rates[Priority.CROWD] == 0.7


def test_rate_of_a_class_without_replans_falls_to_that_of_playing_on() -> None:
    assert _seen(replans=0, sessions=40)[Priority.HERO] == pytest.approx(0.5, rel=0.1)


def test_sessions_that_have_just_opened_do_not_lower_the_rate() -> None:
    rates = WindowRates(0.5)
    for second in range(1, 4):
        rates.update(1.0, {Priority.CROWD: 30 * second})
        for _ in range(6 * second):  # each is edited every five seconds from the start
            rates.note_replan(Priority.CROWD)
    rates.update(0.25, {Priority.CROWD: 90})
    assert rates[Priority.CROWD] == pytest.approx(0.7, rel=0.1)


def test_rate_outlives_the_sessions_and_yields_to_later_ones() -> None:
    rates = _seen(replans=25, sessions=10)
    before = rates[Priority.HERO]
    for _ in range(100):
        rates.update(0.25, {Priority.HERO: 0})
    assert rates[Priority.HERO] == before
    for _ in range(400):
        rates.update(0.25, {Priority.HERO: 10})
    assert rates[Priority.HERO] == pytest.approx(0.6, rel=0.1)
