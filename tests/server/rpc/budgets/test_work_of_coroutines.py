"""Event loop time of a coroutine is measured as work of a stream, from each of its waits to the next."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_server.rpc.budgets.loop_time import Clocks, LoopTime, Work
from tests.server.rpc.budgets.test_loop_time import Clock


async def test_computing_of_a_coroutine_is_work_and_its_waits_are_not() -> None:
    clock, charged = Clock(), list[float]()
    work = Work(LoopTime(0.4, 0.0, Clocks(clock, clock)), charged.append)
    told: list[asyncio.Future[int]] = [asyncio.get_running_loop().create_future() for _ in range(3)]

    async def listening() -> int:
        heard = 0
        for each in told:
            clock.now_s += 0.01
            try:
                heard += await each
            except ValueError:
                heard += 100
        clock.now_s += 0.05
        return heard

    task = asyncio.create_task(work.of(listening))
    for index, future in enumerate(told):
        await asyncio.sleep(0)
        clock.now_s += 60.0  # other tasks have their turn
        future.set_exception(ValueError("wrong")) if index == 1 else future.set_result(index + 1)
    assert await task == 104
    assert charged == [pytest.approx(0.01)] * 3 + [pytest.approx(0.05)]


async def test_measured_coroutine_can_be_cancelled_while_it_waits() -> None:
    work, ending = Work(LoopTime(), lambda _: None), list[str]()

    async def waiting() -> None:
        try:
            await asyncio.get_running_loop().create_future()
        finally:
            ending.append("ended")

    task = asyncio.create_task(work.of(waiting))
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert ending == ["ended"]
