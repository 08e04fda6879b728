"""When a slow reader is given up: after how much backlog, after how long, and how often."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_server.engine.types import Chunk, Close, CloseReason, Open, Opened
from motiongen_server.rpc.limits import Limits
from motiongen_server.rpc.streams.reader_patience import ReaderPatience
from tests.server.rpc.streams.test_event_order import Line, make_catalog

SOFT, HARD = 1000, 4000
LIMITS = Limits(soft_backlog_bytes=SOFT, hard_backlog_bytes=HARD, backlog_s=5.0)


class Patience:
    """A `ReaderPatience` with timers that the test lets expire. given_up: how often the reader was given up."""

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


async def test_backlog_up_to_the_soft_limit_starts_no_timer(patience: Patience) -> None:
    patience.check(SOFT)
    assert (patience.timers, patience.given_up) == ([], 0)


async def test_backlog_above_the_soft_limit_starts_one_timer(patience: Patience) -> None:
    for waiting in (SOFT + 1, HARD, SOFT + 1):
        patience.check(waiting)
    assert (len(patience.timers), patience.given_up) == (1, 0)
    patience.run_out()
    assert patience.given_up == 1


async def test_reader_that_catches_up_in_time_gets_the_full_time_again(patience: Patience) -> None:
    patience.check(HARD)
    patience.check(SOFT)
    assert (len(patience.timers), patience.running) == (1, [])
    patience.check(HARD)
    assert (len(patience.timers), len(patience.running)) == (2, 1)
    assert patience.given_up == 0


async def test_backlog_above_the_hard_limit_is_given_up_at_once(patience: Patience) -> None:
    patience.check(HARD)
    patience.check(HARD + 1)
    assert (patience.given_up, patience.running) == (1, [])


async def test_reader_is_given_up_again_only_for_backlog_that_comes_later(patience: Patience) -> None:
    patience.while_giving_up = lambda: patience.check(HARD + 1)
    patience.check(HARD + 1)
    assert patience.given_up == 1
    patience.check(HARD + 1)
    assert patience.given_up == 2


async def test_end_cancels_the_timer(patience: Patience) -> None:
    patience.check(HARD)
    patience.of_reader.end()
    patience.of_reader.end()
    assert patience.running == []


async def test_client_of_many_sessions_may_have_a_look_ahead_of_each_to_read() -> None:
    line = Line(make_catalog(soft_backlog_bytes=2_000, hard_backlog_bytes=2_000))
    num_sessions, lookahead = 8, 40
    for handle in range(1, 1 + num_sessions):
        event = session_pb2.SessionEvent(session=handle, event_seq=1, open=session_pb2.OpenSession())
        line.stream.receive(event, time.monotonic())
    keys = [event.session for event in line.engine.events]
    for key in keys:
        line.stream.take(Opened(key, 1, 0, lookahead, 4, 4, "tiny", "stick", 20))
    line.updates()
    for key in keys:
        line.stream.take(Chunk(key, 1, 0, np.zeros((lookahead, 3), np.float32), 0))
    assert line.stream.num_waiting_bytes > 2 * 2_000
    assert line.engine.kinds() == [Open] * num_sessions, "none is closed"
    line.stream.take(Chunk(keys[0], 1, lookahead, np.zeros((200, 3), np.float32), 0))
    assert {event.reason for event in line.engine.events if isinstance(event, Close)} == {CloseReason.SLOW_READER}
