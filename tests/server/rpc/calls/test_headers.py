"""Calls with more headers than the server's settings allow: they are refused, and their address pays for them."""

from __future__ import annotations

import asyncio
import gc
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import grpc.aio
import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.loop_time import Clocks
from motiongen_server.rpc.calls import headers
from motiongen_server.rpc.calls.headers import BYTES_A_HEADER, LOOP_SHARE, MOST_BYTES, MOST_OFFENCES, HeaderTime
from tests.raw_calls import answer_to, status_in
from tests.server.rpc.one_method import SERVED, serving
from tests.waiting import until_true

READING_S = 0.25
HERE, ELSEWHERE = "ipv4:10.0.0.1", "ipv4:10.0.0.2"
TOO_MANY = (("k", "v"),) * (MOST_BYTES // (BYTES_A_HEADER + 2) + 1)
AS_MANY_AS_MAY_BE = TOO_MANY[1:]


class Called:
    """The context of a call whose headers take `READING_S` to read if there are too many."""

    def __init__(
        self, clock: list[float], address: str, headers: tuple[tuple[str, str], ...], port: int = 55000
    ) -> None:
        self._clock, self._address, self._headers, self._port = clock, address, headers, port
        self.num_read = 0

    def peer(self) -> str:
        return f"{self._address}:{self._port}"

    def invocation_metadata(self) -> tuple[tuple[str, str], ...]:
        self.num_read += 1
        if len(self._headers) > len(AS_MANY_AS_MAY_BE):
            self._clock[0] += READING_S
        return self._headers


@pytest.fixture
def clock() -> list[float]:
    return [1000.0]


@pytest.fixture
def header_time(clock: list[float]) -> HeaderTime:
    return HeaderTime(Clocks(elapsed_s=lambda: clock[0]))


def reason(header_time: HeaderTime, call: Called) -> str:
    with pytest.raises(StreamRefused) as refused:
        header_time.check(call)
    return refused.value.reason


def test_headers_up_to_the_limit_cost_nothing(header_time: HeaderTime, clock: list[float]) -> None:
    for _ in range(1000):
        header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE))
    assert header_time.num_addresses == 0


def test_address_pays_for_too_many_headers_before_any_are_read_again(
    header_time: HeaderTime, clock: list[float]
) -> None:
    assert reason(header_time, Called(clock, HERE, TOO_MANY)) == "HEADERS_TOO_LONG"
    unread = Called(clock, HERE, TOO_MANY)
    assert reason(header_time, unread) == "TOO_MANY_CALLS"
    assert unread.num_read == 0
    header_time.check(Called(clock, ELSEWHERE, AS_MANY_AS_MAY_BE))
    clock[0] += READING_S / LOOP_SHARE
    assert reason(header_time, Called(clock, HERE, TOO_MANY)) == "HEADERS_TOO_LONG"


def test_connections_that_began_ordinary_calls_before_begin_more_while_their_address_owes(
    header_time: HeaderTime, clock: list[float]
) -> None:
    """As where a hostile client is behind the same address translation."""
    known, hostile, new = 1, 2, 3
    header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, known))
    assert reason(header_time, Called(clock, HERE, TOO_MANY, hostile)) == "HEADERS_TOO_LONG"
    for _ in range(100):
        header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, known))
        assert reason(header_time, Called(clock, HERE, TOO_MANY, hostile)) == "TOO_MANY_CALLS"
        assert reason(header_time, Called(clock, HERE, AS_MANY_AS_MAY_BE, new)) == "TOO_MANY_CALLS"


def test_known_connections_that_send_too_many_headers_are_read_only_so_often(
    header_time: HeaderTime, clock: list[float]
) -> None:
    for port in range(100):
        header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, port))
    began = clock[0]
    reasons = [reason(header_time, Called(clock, HERE, TOO_MANY, port)) for port in range(50)]
    assert reasons.count("HEADERS_TOO_LONG") == 1 + MOST_OFFENCES
    assert reason(header_time, Called(clock, HERE, AS_MANY_AS_MAY_BE, 99)) == "TOO_MANY_CALLS"
    clock[0] = began + (1 + MOST_OFFENCES) * READING_S * (1 + 1 / LOOP_SHARE)
    header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, 99))


def test_connection_that_sent_too_many_headers_is_known_no_longer(header_time: HeaderTime, clock: list[float]) -> None:
    header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE))
    assert reason(header_time, Called(clock, HERE, TOO_MANY)) == "HEADERS_TOO_LONG"
    assert reason(header_time, Called(clock, HERE, AS_MANY_AS_MAY_BE)) == "TOO_MANY_CALLS"


def test_connections_that_have_been_silent_for_longest_are_forgotten(
    header_time: HeaderTime, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(headers, "MOST_KNOWN", 2)
    for port in (1, 2, 1, 3):
        header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, port))
    assert reason(header_time, Called(clock, HERE, TOO_MANY, 9)) == "HEADERS_TOO_LONG"
    for port in (1, 3):
        header_time.check(Called(clock, HERE, AS_MANY_AS_MAY_BE, port))
    assert reason(header_time, Called(clock, HERE, AS_MANY_AS_MAY_BE, 2)) == "TOO_MANY_CALLS"


def test_addresses_that_owe_nothing_any_more_are_forgotten(header_time: HeaderTime, clock: list[float]) -> None:
    for number in range(100):
        assert reason(header_time, Called(clock, f"ipv4:10.0.1.{number}", TOO_MANY)) == "HEADERS_TOO_LONG"
        clock[0] += READING_S / LOOP_SHARE
    assert header_time.num_addresses == 1


@asynccontextmanager
async def served(reached: list[str]) -> AsyncIterator[int]:
    """Yields the port of a server whose method notes each call that reaches it."""

    async def say(_messages: object, context: Any) -> None:
        reached.append(context.peer())

    async with serving(say) as port:
        yield port


async def test_call_with_headers_beyond_the_limit_reaches_no_method(caplog: pytest.LogCaptureFixture) -> None:
    reached: list[str] = []
    header = (b"k", b"v" * 100)
    async with served(reached) as port:
        too_many = await asyncio.to_thread(answer_to, port, SERVED, *[header] * 150)
        assert status_in(too_many) == grpc.StatusCode.INVALID_ARGUMENT.value[0]
        assert reached == []
    async with served(reached) as port:
        few = await asyncio.to_thread(answer_to, port, SERVED, *[header] * 10)
        assert status_in(few) == 0
        assert len(reached) == 1
    assert not [record for record in caplog.records if record.levelname in ("WARNING", "ERROR")]


def num_calls() -> int:
    """The calls that gRPC holds, and those that it waits for."""
    return sum(type(each).__name__ == "RPCState" for each in gc.get_objects())


async def test_refused_calls_are_freed_without_garbage_collection() -> None:
    """Each may hold megabytes of headers, and collections are rare."""
    too_many = [(b"k", b"v" * 100)] * 150
    async with served([]) as port:
        await asyncio.to_thread(answer_to, port, SERVED, *too_many)
        gc.collect()
        gc.disable()
        try:
            waiting = num_calls()
            for _ in range(5):
                await asyncio.to_thread(answer_to, port, SERVED, *too_many)
            await until_true(lambda: num_calls() <= waiting + 1)  # the first may not have ended before it was counted
        finally:
            gc.enable()
