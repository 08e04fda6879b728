"""The pace of health checks: a flood waits, and makes nobody else wait, not even clients of the same address."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_server.errors import StreamRefused
from motiongen_server.rpc.budgets.connection_shares import FORGET_AFTER_S
from motiongen_server.rpc.calls import health_pace
from motiongen_server.rpc.calls.health_pace import (
    CHECKS_PER_SECOND,
    MOST_WAITING,
    MOST_WAITING_OF_A_CONNECTION,
    MOST_WAITING_OF_AN_ADDRESS,
    HealthPace,
)

FLOOD, OTHER = "ipv4:10.0.0.7:1001", "ipv4:10.0.0.7:1002"


class Time:
    """Monotonic seconds, and how long each sleep was to last."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = 1000.0
        self.slept: list[float] = []
        monkeypatch.setattr(health_pace.asyncio, "sleep", self.sleep)

    async def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        await asyncio.Event().wait()


async def _settle(tasks: list[asyncio.Task[None]]) -> int:
    """Lets all tasks begin; returns how many of them were answered."""
    for _ in range(3):
        waited = asyncio.get_running_loop().create_future()
        asyncio.get_running_loop().call_soon(waited.set_result, None)
        await waited
    return sum(task.done() and task.exception() is None for task in tasks)


async def _end(tasks: list[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_flood_gets_one_second_of_answers_then_waits_then_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    tasks = [asyncio.create_task(pace.wait(FLOOD)) for _ in range(500)]
    assert await _settle(tasks) == CHECKS_PER_SECOND
    refused = [task.exception() for task in tasks if task.done() and task.exception() is not None]
    assert len(refused) == 500 - CHECKS_PER_SECOND - MOST_WAITING_OF_A_CONNECTION
    assert all(isinstance(each, StreamRefused) and each.reason == "TOO_MANY_CALLS" for each in refused)
    assert 0 < min(time.slept) <= max(time.slept) <= 1.0
    await _end(tasks)


async def test_places_to_wait_are_free_again_once_the_waiting_have_left(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    for rounds in (1, 2, 3):
        tasks = [asyncio.create_task(pace.wait(FLOOD)) for _ in range(500)]
        await _settle(tasks)
        assert len(time.slept) == rounds * MOST_WAITING_OF_A_CONNECTION
        await _end(tasks)
        time.now += 1.5  # too short for the address to be forgotten
    for _ in range(2):
        peers = [f"ipv4:10.0.0.{host}:{port}" for host in range(10) for port in range(100)]
        tasks = [asyncio.create_task(pace.wait(peer)) for peer in peers for _ in range(4)]
        before = len(time.slept)
        await _settle(tasks)
        assert len(time.slept) - before == MOST_WAITING, "the limit of all addresses together"
        await _end(tasks)
        time.now += 1.5


async def test_other_client_of_a_flooding_address_is_answered_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    await pace.wait(OTHER)
    await _assert_answered_during_a_flood(pace, time)


async def _assert_answered_during_a_flood(pace: HealthPace, time: Time) -> None:
    tasks = [asyncio.create_task(pace.wait(FLOOD)) for _ in range(500)]
    await _settle(tasks)
    for _ in range(20):
        time.now += 0.1  # ten checks a second; its part is fifty
        tasks += [asyncio.create_task(pace.wait(FLOOD)) for _ in range(50)]
        asked = asyncio.create_task(pace.wait(OTHER))
        assert await _settle([asked]) == 1
    await _end(tasks)


async def test_first_check_of_a_connection_is_never_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    peers = [f"ipv4:10.0.0.7:{port}" for port in range(400)]
    tasks = [asyncio.create_task(pace.wait(peer)) for peer in peers for _ in range(4)]
    await _settle(tasks)
    assert len(time.slept) == MOST_WAITING_OF_AN_ADDRESS
    assert max(time.slept) <= 1.0
    first = asyncio.create_task(pace.wait(OTHER))
    assert await _settle([first]) == 1, "no more may wait, so it is answered at once"
    await _end([*tasks, first])


async def test_waiting_checks_of_one_address_delay_no_other_address(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    tasks = [asyncio.create_task(pace.wait(f"ipv4:10.0.0.7:{port}")) for port in range(400) for _ in range(4)]
    await _settle(tasks)
    elsewhere = [asyncio.create_task(pace.wait("ipv4:10.0.0.8:1")) for _ in range(50)]
    assert await _settle(elsewhere) == 50
    await _end([*tasks, *elsewhere])


async def test_connections_that_stop_asking_are_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    for number in range(10_000):
        time.now += 0.02
        await pace.wait(f"ipv4:10.0.{number % 250}.7:{number}")
    assert pace._shares.num_connections < 250
    assert pace._shares.num_addresses < 250


async def test_forgotten_connections_do_not_reduce_the_part_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """A proxy may open a new connection for each check."""
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    for number in range(500):
        time.now += 0.02
        await pace.wait(f"ipv4:10.0.0.7:{number}")
    for _ in range(50):
        time.now += 0.1
        await pace.wait(OTHER)
    await _assert_answered_during_a_flood(pace, time)


async def test_address_in_debt_is_not_forgotten_with_its_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    tasks = [asyncio.create_task(pace.wait(f"ipv4:10.0.0.7:{port}")) for port in range(400)]
    await _settle(tasks)
    await _end(tasks)
    time.now += FORGET_AFTER_S
    again = [asyncio.create_task(pace.wait(FLOOD)) for _ in range(500)]
    assert await _settle(again) < CHECKS_PER_SECOND
    await _end(again)


async def test_many_connections_are_not_all_answered_as_fast_as_they_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each asks for one check after another. Those for which no place to wait is left must not be answered as fast as
    they ask."""
    time = Time(monkeypatch)
    pace = HealthPace(lambda: time.now)
    peers = [f"ipv4:10.0.0.7:{port}" for port in range(300)]
    asked = [asyncio.create_task(pace.wait(peer)) for peer in peers]
    await _settle(asked)
    answered = 0
    for _ in range(50):  # a second
        time.now += 0.02
        free = [peer for peer, task in zip(peers, asked, strict=True) if task.done()]
        again = {peer: asyncio.create_task(pace.wait(peer)) for peer in free}
        answered += await _settle(list(again.values()))
        asked = [again.get(peer, task) for peer, task in zip(peers, asked, strict=True)]
    assert answered <= CHECKS_PER_SECOND + len(peers)
    await _end(asked)
