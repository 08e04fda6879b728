"""What the gateway takes to be in use of an engine since that last told."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import cast

import pytest

from motiongen_server.engine.types import Closed, CloseReason, Code, Open, Outcome, Priority, SessionKey, SessionSpec
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.messages import Pulse, Ready
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec
from tests.waiting import LIMIT_S


def told_of_four() -> ModelLink:
    """A link with four sessions, whose engine has told that they take a fifth of the device, and ask for a tenth."""
    link = ModelLink(1, "model", lambda outputs: None, lambda: None)
    assert link.take_ready(Ready(1, FACTS, "CC0-1.0", NOTHING_CLAIMED))
    opened(link, 1, 4)
    link.take_pulse(Pulse(1, 0.0, (StepReport(load=0.2, asked=0.1),)))
    return link


def opened(link: ModelLink, stream: int, count: int, clip_frames: int | None = None) -> list[SessionKey]:
    priority = Priority.NEAR if clip_frames is None else Priority.BATCH
    keys = [SessionKey(stream, handle) for handle in range(1, count + 1)]
    for key in keys:
        assert link.submit(Open(spec(key, priority=priority, clip_frames=clip_frames), 1, 0.0)) is None
    return keys


def test_a_process_that_finds_other_weights_than_the_one_before_is_not_of_that_model() -> None:
    """As where a folder was replaced under a running server, whose other engines go on with what they hold."""
    link, ready = ModelLink(1, "model", lambda outputs: None, lambda: None), Ready(1, FACTS, "", NOTHING_CLAIMED, "a1")
    assert link.take_ready(ready)
    link.lose(CloseReason.ENGINE_FAULT, "it was killed")
    assert not link.take_ready(replace(ready, weights="b2"))
    assert not link.is_up
    assert link.take_ready(ready), "it was put back"


def test_sessions_that_were_opened_since_add_as_much_as_those_before() -> None:
    link = told_of_four()
    opened(link, 2, 2)
    assert (link.load, link.asked) == pytest.approx((0.3, 0.15))


def test_clips_add_nothing() -> None:
    link = told_of_four()
    opened(link, 2, 16, clip_frames=200)
    assert (link.load, link.asked) == (0.2, 0.1)
    link.take_pulse(Pulse(1, 0.0, (StepReport(load=0.2, asked=0.1),)))
    opened(link, 3, 4)
    assert (link.load, link.asked) == pytest.approx((0.4, 0.2)), "four were there before, and sixteen clips"


def test_who_was_refused_or_has_gone_adds_nothing() -> None:
    link = told_of_four()
    keys = opened(link, 2, 3)
    link.take_outputs([Outcome(keys[0], 1, Code.RESOURCE_EXHAUSTED)])
    link.take_outputs([Closed(keys[1], CloseReason.CLIENT, Code.OK, "", 0, 0)])
    assert (link.load, link.asked) == pytest.approx((0.25, 0.125)), "one of them is left"


def test_who_goes_of_those_that_were_told_of_makes_the_others_no_heavier() -> None:
    link = told_of_four()
    opened(link, 2, 2)
    link.take_outputs([Closed(SessionKey(1, 1), CloseReason.CLIENT, Code.OK, "", 0, 0)])
    assert link.load == pytest.approx(0.3)


class WatchedLock:
    """A lock that sets `reached` when a thread has to wait for it."""

    def __init__(self, reached: threading.Event) -> None:
        self._lock, self._reached = threading.Lock(), reached

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            self._reached.set()
            self._lock.acquire()

    def __exit__(self, *error: object) -> None:
        self._lock.release()


class SpecReadDuringReport:
    """The spec of a session that is known already, so that only the count looks at it. Meanwhile the engine reports
    that it has a place for one session.
    """

    def __init__(self, link: ModelLink, session: SessionKey, reached: threading.Event) -> None:
        self.session = session
        self._link, self._reached = link, reached
        self.thread = threading.Thread(target=self._report)

    def _report(self) -> None:
        self._link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 1.0}),)))
        self._reached.set()

    @property
    def is_clip(self) -> bool:
        if not self.thread.ident:
            self.thread.start()
            assert self._reached.wait(LIMIT_S)
        return False


def test_report_that_comes_while_an_open_is_counted_is_not_mixed_with_the_count_before_it() -> None:
    """Else sessions would be refused until the next report, although there are places."""
    link = told_of_four()
    link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 8.0}),)))
    keys, reached = opened(link, 2, 4), threading.Event()
    link._lock = WatchedLock(reached)  # type: ignore[assignment]
    read = SpecReadDuringReport(link, keys[0], reached)
    assert link.submit(Open(cast(SessionSpec, read), 2, 0.0)) is None
    read.thread.join(LIMIT_S)
    assert not link.refuses(Priority.NEAR, FACTS.default_steps)


def test_a_lost_engine_is_in_use_by_nobody() -> None:
    link = told_of_four()
    opened(link, 2, 2)
    link.lose(CloseReason.ENGINE_FAULT, "lost")
    assert (link.load, link.asked) == (0.0, 0.0)
