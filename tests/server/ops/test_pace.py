"""Paces, which limit how often something may be done: bursts, refill, and shares of addresses."""

from __future__ import annotations

from motiongen_server.ops import pace
from motiongen_server.ops.pace import AddressPaces, Pace


def test_pace_allows_a_burst_and_refills() -> None:
    now = [0.0]
    three = Pace(3, lambda: now[0])
    assert [three.allows() for _ in range(4)] == [True, True, True, False]
    now[0] = 1.0
    assert three.allows()


def test_address_gets_its_share_and_leaves_the_rest_to_others() -> None:
    now = [0.0]
    paces = AddressPaces(5, 3, lambda: now[0])
    assert sum(paces.allows("10.0.0.7") for _ in range(1000)) == 3
    assert sum(paces.allows("10.0.0.8") for _ in range(1000)) == 2, "the rest of the pace"
    now[0] = 1.0
    assert paces.allows("10.0.0.8")


def test_oldest_addresses_are_forgotten() -> None:
    paces = AddressPaces(10**6, 1, lambda: 0.0)
    for number in range(3 * pace.MOST_ADDRESSES):
        assert paces.allows(f"10.0.{number // 250}.{number % 250}")
    assert len(paces._addresses) == pace.MOST_ADDRESSES
