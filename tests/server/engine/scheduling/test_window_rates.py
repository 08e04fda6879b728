"""What a session of each class is expected to ask for."""

import pytest

from motiongen_server.engine.scheduling.window_rates import WindowRates
from motiongen_server.engine.types import Priority


def _seen(replans: int, sessions: int, seconds: float = 60.0) -> WindowRates:
    """So many replans in every quarter of a second."""
    rates = WindowRates(0.5)
    for _ in range(round(seconds / 0.25)):
        for _ in range(replans):
            rates.note_replan(Priority.HERO)
        rates.update(0.25, {Priority.HERO: sessions})
    return rates


def test_until_something_is_seen_a_session_is_expected_to_be_edited_now_and_then() -> None:
    rates = WindowRates(0.5)
    rates.update(0.25, {})
    assert [rates[priority] for priority in Priority] == [1.5, 0.8, 0.7, 0.6]


def test_a_class_that_is_steered_is_expected_to_be_steered() -> None:
    rates = _seen(replans=25, sessions=10)
    assert rates[Priority.HERO] == pytest.approx(10.5, rel=0.15)
    assert rates[Priority.CROWD] == 0.7


def test_a_class_that_is_never_edited_is_soon_expected_to_play_on_only() -> None:
    assert _seen(replans=0, sessions=40)[Priority.HERO] == pytest.approx(0.5, rel=0.1)


def test_many_who_have_just_come_do_not_pass_for_ones_that_ask_for_little() -> None:
    rates = WindowRates(0.5)
    for second in range(1, 4):
        rates.update(1.0, {Priority.CROWD: 30 * second})
        for _ in range(6 * second):  # each is edited every five seconds from the start
            rates.note_replan(Priority.CROWD)
    rates.update(0.25, {Priority.CROWD: 90})
    assert rates[Priority.CROWD] == pytest.approx(0.7, rel=0.1)


def test_what_was_seen_outlives_the_sessions_and_yields_to_what_others_do() -> None:
    rates = _seen(replans=25, sessions=10)
    before = rates[Priority.HERO]
    for _ in range(100):
        rates.update(0.25, {Priority.HERO: 0})
    assert rates[Priority.HERO] == before
    for _ in range(400):
        rates.update(0.25, {Priority.HERO: 10})
    assert rates[Priority.HERO] == pytest.approx(0.6, rel=0.1)
