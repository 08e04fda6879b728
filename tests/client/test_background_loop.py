"""The thread behind the blocking client: whoever waits for it at its end is told, and nothing it ran is left."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from motiongen_client import MotiongenError, SessionEnded
from motiongen_client.background_loop import BackgroundLoop


@pytest.fixture
def loop() -> Iterator[BackgroundLoop]:
    running = BackgroundLoop()
    yield running
    running.stop()


class Counting:
    """A generator without end that says when it was closed."""

    def __init__(self) -> None:
        self.is_closed = False
        self.numbers = self._count()

    async def _count(self) -> AsyncGenerator[int, None]:
        number = 0
        try:
            while True:
                yield number
                number += 1
        finally:
            self.is_closed = True

    async def next(self) -> int:
        return await anext(self.numbers)


def test_who_waits_when_it_is_stopped_is_told(loop: BackgroundLoop) -> None:
    begun = threading.Event()

    async def wait_forever() -> None:
        begun.set()
        await asyncio.Event().wait()

    with ThreadPoolExecutor(1) as other:
        waiting = other.submit(loop.run, wait_forever())
        begun.wait()
        loop.stop()
        with pytest.raises(SessionEnded, match="client was closed"):
            waiting.result()


def test_after_the_end_what_is_asked_is_refused_and_what_ends_has_ended(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.stop()
    loop.stop()
    assert counting.is_closed
    with pytest.raises(SessionEnded, match="client was closed"):
        loop.run(counting.next())
    loop.finish(counting.next())
    loop.leave(counting.numbers)


def test_one_that_is_left_is_closed_before_what_is_asked_next(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.leave(counting.numbers)
    assert loop.call(lambda: counting.is_closed)


def test_one_may_be_left_on_the_thread_of_the_loop(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.call(lambda: loop.leave(counting.numbers))
    assert loop.call(lambda: counting.is_closed)


def test_what_is_raised_there_is_raised_here(loop: BackgroundLoop) -> None:
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 // 0)


def test_on_its_own_thread_nobody_waits_for_it(loop: BackgroundLoop) -> None:
    async def wait_inside() -> list[str]:
        said = []
        for ask in (lambda: loop.call(lambda: 1), loop.stop):
            with pytest.raises(MotiongenError) as raised:
                ask()
            said.append(str(raised.value))
        return said

    assert all("own thread" in each for each in loop.run(wait_inside()))
    assert loop.call(lambda: 1) == 1
