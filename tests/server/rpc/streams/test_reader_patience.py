"""How much waits for a reader before it is given up, for how long, and how often."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

import pytest

from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.streams.reader_patience import ReaderPatience

SOFT, HARD = 1000, 4000
LIMITS = Limits(soft_backlog_bytes=SOFT, hard_backlog_bytes=HARD, backlog_s=5.0)


class Patience:
    """With timers that the test lets run out. given_up: how often."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.given_up = 0
        self.while_giving_up: Callable[[], object] = lambda: None
        self.timers: list[asyncio.TimerHandle] = []
        self.of_reader = ReaderPatience(LIMITS, self._give_up)
        loop = asyncio.get_running_loop()
        call_later = loop.call_later

        def note(delay_s: float, callback: Callable[[], None]) -> asyncio.TimerHandle:
            assert delay_s == 5.0
            self.timers.append(call_later(1e6, callback))
            return self.timers[-1]

        monkeypatch.setattr(loop, "call_later", note)
        self.check = self.of_reader.check

    def _give_up(self) -> None:
        self.given_up += 1
        self.while_giving_up()

    @property
    def running(self) -> list[asyncio.TimerHandle]:
        return [timer for timer in self.timers if not timer.cancelled()]

    def run_out(self) -> None:
        (timer,) = self.running
        timer._run()  # type: ignore[attr-defined]


@pytest.fixture
async def patience(monkeypatch: pytest.MonkeyPatch) -> Patience:
    return Patience(monkeypatch)


async def test_what_may_wait_for_ever_does(patience: Patience) -> None:
    patience.check(SOFT)
    assert (patience.timers, patience.given_up) == ([], 0)


async def test_what_may_wait_for_a_while_is_waited_for_once(patience: Patience) -> None:
    for waiting in (SOFT + 1, HARD, SOFT + 1):
        patience.check(waiting)
    assert (len(patience.timers), patience.given_up) == (1, 0)
    patience.run_out()
    assert patience.given_up == 1


async def test_who_reads_in_time_is_not_given_up_and_has_as_long_again(patience: Patience) -> None:
    patience.check(HARD)
    patience.check(SOFT)
    assert (len(patience.timers), patience.running) == (1, [])
    patience.check(HARD)
    assert (len(patience.timers), len(patience.running)) == (2, 1)
    assert patience.given_up == 0


async def test_too_much_at_once_is_not_waited_for(patience: Patience) -> None:
    patience.check(HARD)
    patience.check(HARD + 1)
    assert (patience.given_up, patience.running) == (1, [])


async def test_what_is_told_of_the_end_gives_nobody_up_a_second_time_and_new_sessions_do(patience: Patience) -> None:
    patience.while_giving_up = lambda: patience.check(HARD + 1)
    patience.check(HARD + 1)
    assert patience.given_up == 1
    patience.check(HARD + 1)
    assert patience.given_up == 2


async def test_after_the_end_nothing_is_waited_for(patience: Patience) -> None:
    patience.check(HARD)
    patience.of_reader.end()
    patience.of_reader.end()
    assert patience.running == []
