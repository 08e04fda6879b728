"""Calls that begin faster than one address may begin them: gRPC ends them, and those of other addresses begin."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

import pytest

from motiongen_server.rpc import grpc_server
from motiongen_server.rpc.calls import call_pace
from motiongen_server.rpc.calls.call_pace import CALLS_A_SECOND, HEADERS_A_CALL, MOST_IDLE, CallPace
from tests.raw_calls import answer_to, status_in
from tests.server.rpc.one_method import SERVED, serving

HERE, ELSEWHERE = "ipv4:10.0.0.1", "ipv4:10.0.0.2"
OK, CANCELLED, UNIMPLEMENTED = 0, 1, 12


@pytest.fixture
def clock() -> list[float]:
    return [1000.0]


@pytest.fixture
def pace(clock: list[float]) -> CallPace:
    return CallPace(lambda: clock[0])


def test_calls_a_second_of_an_address_are_limited_across_its_connections(pace: CallPace, clock: list[float]) -> None:
    begun = [pace.allows(f"{HERE}:{port}") for port in range(3 * CALLS_A_SECOND)]
    assert begun == [True] * CALLS_A_SECOND + [False] * (2 * CALLS_A_SECOND)
    assert pace.allows(f"{ELSEWHERE}:55000")
    clock[0] += 0.25
    assert sum(pace.allows(f"{HERE}:55000") for _ in range(CALLS_A_SECOND)) == CALLS_A_SECOND // 4


def test_headers_beyond_those_of_an_ordinary_call_count_as_calls(pace: CallPace, clock: list[float]) -> None:
    def begin(num_headers: int) -> int:
        """How many calls with that many headers may begin at once."""
        clock[0] += 1e6
        num_begun = 0
        while pace.allows(f"{HERE}:1"):
            pace.charge(f"{HERE}:1", num_headers)
            num_begun += 1
        return num_begun

    assert begin(HEADERS_A_CALL - 1) == CALLS_A_SECOND
    assert begin(HEADERS_A_CALL) == CALLS_A_SECOND // 2
    assert begin(7 * HEADERS_A_CALL) == CALLS_A_SECOND // 8


def test_idle_addresses_are_forgotten_once_there_are_many(pace: CallPace, clock: list[float]) -> None:
    for number in range(1, MOST_IDLE):
        pace.allows(f"ipv4:10.1.{number // 256}.{number % 256}:1")
    for _ in range(CALLS_A_SECOND):
        pace.allows(f"{HERE}:1")
    clock[0] += 0.5
    pace.allows(f"{ELSEWHERE}:1")
    assert pace.num_addresses == 2, "an address that has used up its calls is remembered"
    assert sum(pace.allows(f"{HERE}:1") for _ in range(CALLS_A_SECOND)) == CALLS_A_SECOND // 2


async def test_calls_over_the_limit_are_cancelled_and_reach_no_method(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(call_pace, "CALLS_A_SECOND", 3)
    monkeypatch.setattr(grpc_server, "CallPace", partial(CallPace, lambda: 0.0))
    reached: list[str] = []

    async def say(_messages: object, context: Any) -> None:
        reached.append(context.peer())

    async with serving(say) as port:
        said = [status_in(await asyncio.to_thread(answer_to, port, SERVED)) for _ in range(6)]
        assert said == [OK] * 3 + [CANCELLED] * 3
        assert len(reached) == 3
        said = [status_in(await asyncio.to_thread(answer_to, port, b"/nobody.Serves/This")) for _ in range(6)]
        assert said == [UNIMPLEMENTED] * 3 + [CANCELLED] * 3
    async with serving(say) as port:
        many = [(b"k", b"v")] * (3 * HEADERS_A_CALL)
        said = [status_in(await asyncio.to_thread(answer_to, port, SERVED, *many)) for _ in range(2)]
        assert said == [OK, CANCELLED]
    assert not caplog.records
