"""How often something may be done: bursts, what comes back, and what one address leaves to others."""

from __future__ import annotations

from motiongen_server.ops import pace
from motiongen_server.ops.pace import AddressPaces, Pace


def test_a_pace_lets_bursts_pass_and_comes_back() -> None:
    now = [0.0]
    three = Pace(3, lambda: now[0])
    assert [three.allows() for _ in range(4)] == [True, True, True, False]
    now[0] = 1.0
    assert three.allows()


def test_an_address_has_a_part_and_what_it_is_refused_is_left_to_others() -> None:
    now = [0.0]
    paces = AddressPaces(5, 3, lambda: now[0])
    assert sum(paces.allows("10.0.0.7") for _ in range(1000)) == 3
    assert sum(paces.allows("10.0.0.8") for _ in range(1000)) == 2, "all that may be"
    now[0] = 1.0
    assert paces.allows("10.0.0.8")


def test_addresses_that_came_long_ago_are_forgotten() -> None:
    paces = AddressPaces(10**6, 1, lambda: 0.0)
    for number in range(3 * pace.MOST_ADDRESSES):
        assert paces.allows(f"10.0.{number // 250}.{number % 250}")
    assert len(paces._addresses) == pace.MOST_ADDRESSES
