"""How many calls a caller may have open, and what that leaves for others."""

from __future__ import annotations

import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.call_places import CallPlaces


def test_open_calls_of_an_address_are_limited_and_ended_ones_free_a_place() -> None:
    places = CallPlaces(100)
    given_back = [places.take("one", "one:1", 3) for _ in range(3)]
    with pytest.raises(StreamRefused, match="your address has as many calls open as it may, 3") as refused:
        places.take("one", "one:1", 3)
    assert refused.value.reason == "TOO_MANY_CALLS"
    places.take("two", "two:1", 3)
    given_back.pop()()
    places.take("one", "one:1", 3)


def test_first_call_of_a_connection_has_twice_the_limit_of_its_address() -> None:
    places = CallPlaces(100)
    for _ in range(3):
        places.take("one", "one:1", 3)
    for connection in range(2, 5):
        places.take("one", f"one:{connection}", 3)
        with pytest.raises(StreamRefused):
            places.take("one", f"one:{connection}", 3)
    with pytest.raises(StreamRefused):
        places.take("one", "one:5", 3)
    places.take("two", "two:1", 3)


def test_open_calls_of_a_tenant_are_limited_across_its_connections() -> None:
    places = CallPlaces(100)
    for number in range(4):
        places.take("tenant:a", f"ipv4:10.0.0.1:{number}", 4, "tenant")
    for number in range(9):
        with pytest.raises(StreamRefused, match="your tenant has as many calls open as it may, 4"):
            places.take("tenant:a", f"ipv4:10.0.0.1:{number}", 4, "tenant")
    places.take("ipv4:10.0.0.1", "ipv4:10.0.0.1:1", 4)


def test_open_calls_of_all_are_limited_and_ended_ones_are_forgotten() -> None:
    places = CallPlaces(2)
    first, second = places.take("one", "one:1", 9), places.take("two", "two:1", 9)
    with pytest.raises(StreamRefused, match="there are as many calls open as there may be, 2"):
        places.take("three", "three:1", 9)
    first()
    second()
    assert not places._taken
    assert not places._of_connection
