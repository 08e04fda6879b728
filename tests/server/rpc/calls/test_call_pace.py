"""Calls that come faster than one address may begin them: gRPC ends them, and others' are begun."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

import pytest

from motiongen_server.config import ServerConfig
from motiongen_server.rpc import grpc_server
from motiongen_server.rpc.budgets.connection_shares import FORGET_AFTER_S
from motiongen_server.rpc.calls.call_pace import (
    CALLS_A_SECOND,
    HEADERS_A_CALL,
    MOST_OWED_S,
    CallPace,
    calls_a_second,
)
from motiongen_server.text.encoder.config import EncoderConfig
from motiongen_server.transport import make_grpc_server
from tests.raw_calls import answer_to, status_in
from tests.server.rpc.one_method import SERVED, serving

HERE, ELSEWHERE = "ipv4:10.0.0.1", "ipv4:10.0.0.2"
OK, CANCELLED, UNIMPLEMENTED = 0, 1, 12
RATE = 256
"""A power of two: its sums with the steps of the clock below are exact."""


@pytest.fixture
def clock() -> list[float]:
    return [1000.0]


@pytest.fixture
def pace(clock: list[float]) -> CallPace:
    return CallPace(RATE, lambda: clock[0])


def begun(pace: CallPace, peer: str, asked: int = 3 * RATE) -> int:
    """How many of so many calls are begun at once."""
    return sum(pace.allows(peer) for _ in range(asked))


def test_address_begins_as_many_calls_a_second_as_its_rate(pace: CallPace, clock: list[float]) -> None:
    assert begun(pace, f"{HERE}:1") == RATE + 1
    assert begun(pace, f"{ELSEWHERE}:1") == RATE + 1
    for _ in range(8):
        clock[0] += 0.25
        assert begun(pace, f"{HERE}:1") == RATE // 4


def test_connection_within_its_share_begins_all_calls_while_another_of_its_address_floods(
    pace: CallPace, clock: list[float]
) -> None:
    """As where both are behind one proxy or address translation."""
    num_flooded = begun(pace, f"{HERE}:1")
    for _ in range(64):
        assert pace.allows(f"{HERE}:2")
        num_flooded += begun(pace, f"{HERE}:1", RATE)
        clock[0] += 1 / 32
    assert num_flooded <= RATE + 1 + 2 * RATE - 64, "both together keep to the rate"


def test_new_connections_are_ahead_of_the_pace_of_their_address_only_so_far(pace: CallPace, clock: list[float]) -> None:
    def begun_on_new_connections(first: int) -> int:
        return sum(pace.allows(f"{HERE}:{first + number}") for number in range(4 * RATE))

    assert begun_on_new_connections(1) == RATE + MOST_OWED_S * RATE + 1
    for second in range(1, 5):
        clock[0] += 1.0
        assert begun_on_new_connections(4 * RATE * second) == RATE


def test_headers_beyond_those_of_a_caller_count_as_calls(pace: CallPace, clock: list[float]) -> None:
    def begun_with(num_headers: int) -> int:
        clock[0] += 1024.0
        num_begun = 0
        while pace.allows(f"{HERE}:1"):
            pace.charge(f"{HERE}:1", num_headers)
            num_begun += 1
        return num_begun

    assert begun_with(HEADERS_A_CALL - 1) == RATE + 1
    assert begun_with(HEADERS_A_CALL) == RATE // 2 + 1
    assert begun_with(7 * HEADERS_A_CALL) == RATE // 8 + 1


def test_silent_addresses_are_forgotten_once_they_owe_nothing(pace: CallPace, clock: list[float]) -> None:
    for number in range(1, RATE):
        pace.allows(f"ipv4:10.1.0.{number}:1")
    for number in range(2 * RATE):
        pace.allows(f"{HERE}:{number}")
    clock[0] += FORGET_AFTER_S / 2
    pace.allows(f"{HERE}:1")
    clock[0] += FORGET_AFTER_S / 2
    pace.allows(f"{ELSEWHERE}:1")
    assert pace.num_addresses == 2
    clock[0] += FORGET_AFTER_S
    pace.allows(f"{ELSEWHERE}:1")
    assert pace.num_addresses == 1


@pytest.mark.parametrize(
    ("asked", "of_peers", "rate"),
    [(None, 100.0, CALLS_A_SECOND), (None, 5000.0, 5000.0), (50.0, 5000.0, 50.0), (1e6, 100.0, 1e6)],
)
def test_pace_is_what_is_asked_for_or_no_less_than_peers_may_call(
    asked: float | None, of_peers: float, rate: float
) -> None:
    assert calls_a_second(asked, of_peers) == rate
    for config in (
        ServerConfig(address_calls_per_second=asked, peer_calls_per_second=of_peers),
        EncoderConfig(address_calls_per_second=asked, peer_calls_per_second=of_peers),
    ):
        assert calls_a_second(config.address_calls_per_second, config.peer_calls_per_second) == rate


async def test_server_has_the_pace_of_its_settings() -> None:
    server = make_grpc_server(ServerConfig(address_calls_per_second=2.0))
    assert server._server._paces[b"service"].rate == 2.0


async def test_calls_beyond_the_pace_are_cancelled_before_any_method_and_services_count_separately(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(grpc_server, "CallPace", partial(CallPace, clock=lambda: 0.0))
    reached: list[str] = []

    async def say(_messages: object, context: Any) -> None:
        reached.append(context.peer())

    rate = 2
    most = rate + int(MOST_OWED_S * rate) + 1  # each call comes over a connection of its own
    async with serving(say, rate) as port:
        said = [status_in(await asyncio.to_thread(answer_to, port, SERVED)) for _ in range(most + 3)]
        assert said == [OK] * most + [CANCELLED] * 3
        assert len(reached) == most
        said = [status_in(await asyncio.to_thread(answer_to, port, b"/nobody.Serves/This")) for _ in range(most + 3)]
        assert said == [UNIMPLEMENTED] * most + [CANCELLED] * 3
    async with serving(say, rate) as port:
        many = [(b"k", b"v")] * (most * HEADERS_A_CALL)
        said = [status_in(await asyncio.to_thread(answer_to, port, SERVED, *many)) for _ in range(2)]
        assert said == [OK, CANCELLED]
    assert not caplog.records
