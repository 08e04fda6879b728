from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from motiongen_server.engine.config import EngineConfig
from motiongen_server.engine.scheduling.admission import Admission
from motiongen_server.engine.scheduling.prices import Prices
from motiongen_server.engine.scheduling.window_rates import EXPECTED_HZ, WindowRates
from motiongen_server.engine.types import NOBODY, Code, Owner, Priority, SessionKey
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec

PRICES = Prices(step_s=0.0015, window_s=0.002)
CONFIG = EngineConfig()
PLAYING = FACTS.fps / FACTS.horizon * (4 * 0.0015 + 0.002)
"""The share of the machine that a session takes if it is never edited."""
RATE = FACTS.fps / FACTS.horizon + EXPECTED_HZ[Priority.NEAR]
"""Windows a second that a session is expected to ask for."""
EACH = {each: PLAYING + EXPECTED_HZ[each] * (4 * 0.0015 + 0.002) for each in Priority}


def _admission(prices: Prices = PRICES, measured: float = 0.0, **limits: object) -> Admission:
    admission = Admission(FACTS, EngineConfig(max_sessions=1000, **limits))  # type: ignore[arg-type]
    admission.set_prices(prices, measured)
    return admission


def _fill(admission: Admission, priority: Priority = Priority.NEAR, num_steps: int = 4, first: int = 0) -> int:
    """How many sessions are admitted before one is refused."""
    for number in range(10_000):
        if admission.reserve(spec(SessionKey(1, first + number), priority=priority, num_steps=num_steps), 1):
            return number
        admission.note_begun(SessionKey(1, first + number))
    raise AssertionError("every session was admitted")


def test_sessions_are_admitted_up_to_the_measured_capacity() -> None:
    admission = _admission()
    limit = CONFIG.admit_load[Priority.NEAR - 1]
    assert _fill(admission) == int(limit / EACH[Priority.NEAR])
    assert admission.load <= limit


def test_sessions_with_more_steps_take_more_capacity() -> None:
    few, many = _fill(_admission(), num_steps=2), _fill(_admission(), num_steps=10)
    assert few > 2 * many


def test_sessions_of_a_steered_class_count_with_their_measured_edits() -> None:
    rates = WindowRates(FACTS.fps / FACTS.horizon)
    for _ in range(1000):
        for _ in range(10):
            rates.note_replan(Priority.HERO)
        rates.update(0.25, {Priority.HERO: 8})  # five windows a second each
    admission = _admission()
    admission.set_prices(PRICES, 0.0, rates=rates)
    heroes = _fill(admission, Priority.HERO)
    assert heroes == pytest.approx(CONFIG.admit_load[0] / (11 * PLAYING), rel=0.15)
    assert _fill(admission, Priority.CROWD, first=1000) <= 2
    for number in range(heroes):
        admission.release(SessionKey(1, number))
    for number in range(1000, 1010):
        admission.release(SessionKey(1, number))
    assert _fill(admission, Priority.CROWD) == int(CONFIG.admit_load[2] / EACH[Priority.CROWD])


def test_refusal_says_when_to_retry_and_what_is_allowed() -> None:
    admission = _admission()
    _fill(admission)
    refusals = [admission.reserve(spec(SessionKey(2, number)), 7) for number in range(20)]
    hints = set()
    for refusal in refusals:
        assert refusal is not None
        assert (refusal.code, refusal.reason, refusal.field) == (Code.RESOURCE_EXHAUSTED, "OVERLOADED", "open")
        assert (refusal.event_seq, refusal.effective_frame) == (7, None)
        assert "NEAR" in refusal.allowed
        assert refusal.retry_after_s is not None
        hints.add(refusal.retry_after_s)
    assert 2.0 <= min(hints) <= max(hints) <= 4.0
    assert len(hints) >= 15  # clients do not all retry at once
    assert admission.take_refused()[Code.RESOURCE_EXHAUSTED] == 21
    assert not admission.take_refused()


def test_refusal_counts_once_taken_do_not_change_any_more() -> None:
    admission = Admission(FACTS, EngineConfig(max_sessions=1))
    assert admission.reserve(spec(SessionKey(1, 1)), 1) is None
    told = [admission.take_refused()]
    for number in range(2, 5):  # from another thread, while the counts taken before are still read
        assert admission.reserve(spec(SessionKey(1, number)), 1) is not None
        assert not told[0]
    told += [admission.take_refused(), admission.take_refused()]
    assert told == [{}, {Code.RESOURCE_EXHAUSTED: 3}, {}]


def test_free_share_falls_to_zero_as_sessions_are_admitted() -> None:
    admission = _admission()
    assert admission.free_share == 1.0
    most = int(CONFIG.admit_load[Priority.NEAR - 1] / EACH[Priority.NEAR])
    for number in range(most // 2):
        admission.reserve(spec(SessionKey(1, number)), 1)
        admission.note_begun(SessionKey(1, number))
    assert admission.free_share == pytest.approx(0.5, abs=1 / most)
    _fill(admission, first=1000)
    assert admission.free_share < 1 / most
    admission.set_prices(PRICES, measured=2.0)
    assert admission.free_share == 0.0


def test_free_share_follows_max_sessions_and_is_zero_once_closed() -> None:
    few = Admission(FACTS, EngineConfig(max_sessions=4))
    for number in range(3):
        few.reserve(spec(SessionKey(1, number)), 1)
    assert few.free_share == 0.25
    few.close()
    assert few.free_share == 0.0


def test_more_urgent_classes_are_admitted_after_others_are_refused() -> None:
    admission = _admission()
    for number, priority in enumerate(reversed(Priority)):
        assert _fill(admission, priority, first=1000 * number) > 0
    assert admission.load == pytest.approx(CONFIG.admit_load[0], abs=EACH[Priority.HERO])


def test_rush_of_opens_is_admitted_up_to_a_second_of_first_windows() -> None:
    admission = _admission()
    at_once = 0
    while admission.reserve(spec(SessionKey(1, at_once)), 1) is None:
        at_once += 1
    assert 0.5 * at_once < 0.92 / 0.008 < 2 * at_once  # about a second's work of first windows
    for number in range(at_once):
        admission.note_begun(SessionKey(1, number))
    assert _fill(admission, first=1000) > 0


@pytest.mark.parametrize("under_quota", [False, True])
def test_rush_may_use_all_capacity_except_under_a_quota(under_quota: bool) -> None:
    admission, limit = Admission(FACTS, CONFIG, under_quota=under_quota), CONFIG.admit_load[Priority.NEAR - 1]
    admission.set_prices(PRICES, 0.0)
    playing = int(0.9 * limit / EACH[Priority.NEAR])
    for number in range(playing):
        assert admission.reserve(spec(SessionKey(1, number)), 1) is None
        admission.note_begun(SessionKey(1, number))
    at_once = 0
    while admission.reserve(spec(SessionKey(1, playing + at_once)), 1) is None:
        at_once += 1
    one_after_the_other = int(limit / EACH[Priority.NEAR])
    assert playing + at_once < one_after_the_other if under_quota else playing + at_once == one_after_the_other


def test_sessions_released_before_they_begin_block_no_later_ones() -> None:
    admission = _admission()
    for number in range(10_000):
        assert admission.reserve(spec(SessionKey(1, number)), 1) is None
        admission.release(SessionKey(1, number))
    assert admission.num_beginning == 0


def test_released_place_can_be_taken_again() -> None:
    admission = _admission()
    _fill(admission)
    admission.release(SessionKey(1, 0))
    assert admission.reserve(spec(SessionKey(2, 0)), 1) is None
    assert admission.reserve(spec(SessionKey(2, 1)), 1) is not None


def test_measured_load_counts_beside_the_load_that_sessions_ask_for() -> None:
    admission = _admission(measured=0.89)
    assert admission.reserve(spec(SessionKey(1, 1)), 1) is None  # the first is always admitted
    admission.note_begun(SessionKey(1, 1))
    admission.set_prices(PRICES, CONFIG.admit_load[Priority.NEAR - 1] - 0.001)
    assert admission.reserve(spec(SessionKey(1, 2)), 1) is not None
    admission.set_prices(PRICES, 0.2)
    assert admission.reserve(spec(SessionKey(1, 2)), 1) is None


def test_machine_too_slow_for_one_session_still_admits_one() -> None:
    admission = _admission(Prices(step_s=10.0))
    assert _fill(admission) == 1


def test_draining_server_admits_no_session() -> None:
    admission = _admission()
    admission.close()
    refusal = admission.reserve(spec(SessionKey(1, 1)), 1)
    assert refusal is not None
    assert (refusal.code, refusal.reason, refusal.field) == (Code.UNAVAILABLE, "DRAINING", "open")


@given(st.integers(0, 60), st.sampled_from(Priority), st.floats(0.0, 1.1))
def test_reported_places_equal_the_sessions_then_admitted(sessions: int, priority: Priority, measured: float) -> None:
    admission = _admission(measured=measured)
    for number in range(sessions):
        admission.reserve(spec(SessionKey(1, number), num_steps=4), 1)
        admission.note_begun(SessionKey(1, number))
    places = admission.places()[priority]
    assert (places >= 1.0) == (admission.refusal_of(priority, FACTS.default_steps) is None)
    assert (places > 0.0) == (admission.refusal_of(priority, FACTS.min_steps) is None)
    if measured < admission.asked:
        admitted = _fill(admission, priority, FACTS.default_steps, first=1000)
        assert admitted == int(places) or places == inf


def test_reused_key_keeps_the_place_of_the_later_session() -> None:
    admission = _admission()
    old, new = spec(SessionKey(1, 1)), spec(SessionKey(1, 1), num_steps=10)
    admission.reserve(old, 1)
    admission.release(old.session)  # the Close came
    admission.reserve(new, 2)
    admission.release(old.session, old)  # and only now the engine ends the old one
    assert admission.asked == pytest.approx(RATE * (10 * 0.0015 + 0.002))
    admission.release(new.session, new)
    assert admission.asked == 0.0


@given(st.lists(st.tuples(st.integers(0, 9), st.sampled_from((2, 4, 10)), st.booleans()), max_size=60))
def test_load_asked_for_always_matches_the_sessions_present(moves: list[tuple[int, int, bool]]) -> None:
    admission = _admission()
    there: dict[SessionKey, int] = {}
    for handle, num_steps, comes in moves:
        key = SessionKey(1, handle)
        if not comes:
            admission.release(key)
            there.pop(key, None)
        elif admission.reserve(spec(key, num_steps=num_steps), 1) is None:
            there.setdefault(key, num_steps)
    expected = sum(RATE * (steps * PRICES.step_s + PRICES.window_s) for steps in there.values())
    assert admission.asked == pytest.approx(expected)


def test_changed_options_count_as_if_the_session_had_opened_with_them() -> None:
    admission = _admission()
    others, old = spec(SessionKey(1, 1), num_steps=4), spec(SessionKey(1, 2), num_steps=4)
    new = spec(SessionKey(1, 2), priority=Priority.CROWD, num_steps=10)
    for each in (others, old):
        assert admission.reserve(each, 1) is None
    assert admission.change(old, new) is None
    expected = _admission()
    for each in (others, new):
        assert expected.reserve(each, 1) is None
    assert admission.asked_by_class == pytest.approx(expected.asked_by_class)
    admission.release(new.session, old)
    assert admission.asked_by_class == pytest.approx(expected.asked_by_class), "it no longer has the old spec"
    admission.release(new.session, new)
    admission.release(others.session)
    assert admission.asked == 0.0


def test_lone_session_may_change_to_more_than_the_machine_can_do() -> None:
    admission = _admission(Prices(step_s=10.0))
    old, new = spec(SessionKey(1, 1), num_steps=2), spec(SessionKey(1, 1), num_steps=10)
    assert admission.reserve(old, 1) is None
    assert admission.change(old, new) is None


def test_places_include_what_edits_beyond_their_owners_part_give_up() -> None:
    admission = _admission(measured=0.85)
    for handle in (1, 2):
        assert admission.reserve(spec(SessionKey(1, handle), owner=Owner(f"{handle}")), 1) is None
        admission.note_begun(SessionKey(1, handle))
    before = admission.places()[Priority.NEAR]
    admission.set_prices(PRICES, 0.85, edits_hz={"1": 100.0})
    yielding = admission.yielding(NOBODY)
    assert yielding > 0.2
    assert admission.places()[Priority.NEAR] == pytest.approx(before + yielding / EACH[Priority.NEAR])
