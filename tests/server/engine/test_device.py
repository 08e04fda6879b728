"""What engines of one process share: turns go round, waiting is no work, and what one uses nobody else promises."""

from __future__ import annotations

import threading

import pytest

from server.engine.admission import Admission, Prices
from server.engine.config import EngineConfig
from server.engine.device import Device
from server.engine.types import Code, SessionKey
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec

JOIN_S = 10.0


def test_turns_are_given_in_the_order_they_were_asked_for() -> None:
    device, order = Device(), list[int]()
    device.take()
    threads = []
    for number in range(5):

        def turn(number: int = number) -> None:
            with device.seat():
                order.append(number)

        thread = threading.Thread(target=turn)
        thread.start()
        while device.num_waiting <= number:
            thread.join(0.001)
        threads.append(thread)
    device.pass_on()
    for thread in threads:
        thread.join(JOIN_S)
    assert order == [0, 1, 2, 3, 4]


def test_one_who_comes_again_at_once_waits_behind_who_waits() -> None:
    device, order = Device(), list[str]()
    busy, other = device.seat(), device.seat()

    def wait_once() -> None:
        with other:
            order.append("other")

    with busy:
        thread = threading.Thread(target=wait_once)
        thread.start()
        while not device.num_waiting:
            thread.join(0.001)
    with busy:
        order.append("busy again")
    thread.join(JOIN_S)
    assert order == ["other", "busy again"]


def test_a_turn_ends_with_an_error() -> None:
    seat = Device().seat()
    with pytest.raises(RuntimeError), seat:
        raise RuntimeError("in a step")
    with seat:
        pass


def test_each_knows_what_the_others_use_and_forgets_who_has_left() -> None:
    device = Device()
    seats = [device.seat() for _ in range(3)]
    for seat, load in zip(seats, (0.2, 0.3, 0.1), strict=True):
        seat.load = load
    assert seats[0].elsewhere == pytest.approx(0.4)
    assert seats[0].stretch == pytest.approx(1 / 0.6)
    seats[1].leave()
    assert (seats[0].elsewhere, device.load) == (pytest.approx(0.1), pytest.approx(0.3))
    seats[2].leave()
    assert (seats[0].elsewhere, seats[0].stretch) == (0.0, 1.0)


def test_a_window_takes_no_longer_than_one_turn_of_each_engine_for_each_of_its_steps() -> None:
    device = Device()
    mine, other = device.seat(), device.seat()
    other.load = 3.0
    assert mine.stretch == 2.0


@pytest.mark.parametrize("elsewhere", [0.45, 0.95])
def test_what_other_engines_use_is_not_promised_again(elsewhere: float) -> None:
    admission = Admission(FACTS, EngineConfig(admit_load=(0.9, 0.9, 0.9, 0.9)))
    admission.set_prices(Prices(step_s=0.0, window_s=0.1 * FACTS.horizon / FACTS.fps), 0.0, elsewhere)  # 0.1 a session
    taken = 0
    while (refusal := admission.reserve(spec(SessionKey(1, taken)), 1)) is None:
        taken += 1
    assert refusal.code is Code.RESOURCE_EXHAUSTED
    assert taken == (4 if elsewhere == 0.45 else 0)
