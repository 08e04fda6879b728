"""The thread behind the blocking client: its end reaches callers that wait for it, and it leaves nothing running."""

from __future__ import annotations

import asyncio
import subprocess
import sys
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
    """A generator without end that records when it was closed."""

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


def test_stopping_the_loop_ends_a_waiting_call_with_session_ended(loop: BackgroundLoop) -> None:
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


def test_stopped_loop_closes_generators_and_refuses_calls_but_not_cleanup(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.stop()
    loop.stop()
    assert counting.is_closed
    with pytest.raises(SessionEnded, match="client was closed"):
        loop.run(counting.next())
    loop.finish(counting.next())
    loop.leave(counting.numbers)


def test_abandoned_generator_is_closed_before_the_next_call(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.leave(counting.numbers)
    assert loop.call(lambda: counting.is_closed)


def test_generator_may_be_abandoned_on_the_thread_of_the_loop(loop: BackgroundLoop) -> None:
    counting = Counting()
    assert loop.run(counting.next()) == 0
    loop.call(lambda: loop.leave(counting.numbers))
    assert loop.call(lambda: counting.is_closed)


def test_exception_on_the_loop_is_raised_in_the_calling_thread(loop: BackgroundLoop) -> None:
    with pytest.raises(ZeroDivisionError):
        loop.call(lambda: 1 // 0)


def test_blocking_calls_on_the_thread_of_the_loop_are_refused(loop: BackgroundLoop) -> None:
    async def wait_inside() -> list[str]:
        said = []
        for ask in (lambda: loop.call(lambda: 1), loop.stop):
            with pytest.raises(MotiongenError) as raised:
                ask()
            said.append(str(raised.value))
        return said

    assert all("own thread" in each for each in loop.run(wait_inside()))
    assert loop.call(lambda: 1) == 1


IN_A_FORK = """
import asyncio, os
from motiongen_client import MotiongenError
from motiongen_client.background_loop import BackgroundLoop

async def numbers():
    yield 1

async def work():
    return 2

loop = BackgroundLoop()
generator = numbers()
assert loop.run(anext(generator)) == 1
if not (child := os.fork()):
    try:
        loop.run(work())
    except MotiongenError as refusal:
        print(refusal, flush=True)
    loop.finish(work())
    loop.leave(generator)
    loop.stop()
    os._exit(3)
assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
assert loop.run(work()) == 2
loop.stop()
"""


def test_calls_in_a_forked_process_are_refused_and_it_has_nothing_to_close() -> None:
    command = [sys.executable, "-W", "error", "-W", "ignore:This process:DeprecationWarning", "-c", IN_A_FORK]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert "this process was forked" in ended.stdout
    assert (ended.returncode, ended.stderr) == (0, "")
