"""The load that the gateway assumes of an engine since its last report."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import cast

import pytest

from motiongen_server.engine.types import (
    Close,
    Closed,
    CloseReason,
    Code,
    Open,
    Outcome,
    Priority,
    SessionKey,
    SessionSpec,
)
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.messages import Pulse, Ready
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec
from tests.waiting import LIMIT_S


def link_with_four_sessions() -> ModelLink:
    """A link with four sessions, whose engine has reported that they take a fifth of the device and ask for a tenth."""
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


def test_process_with_other_weights_than_before_is_not_accepted() -> None:
    """For example when a folder was replaced under a running server, whose other engines keep what they hold."""
    link, ready = ModelLink(1, "model", lambda outputs: None, lambda: None), Ready(1, FACTS, "", NOTHING_CLAIMED, "a1")
    assert link.take_ready(ready)
    link.lose(CloseReason.ENGINE_FAULT, "it was killed")
    assert not link.take_ready(replace(ready, weights="b2"))
    assert not link.is_up
    assert link.take_ready(ready), "the first weights were restored"


def test_sessions_opened_since_the_report_add_as_much_as_earlier_ones() -> None:
    link = link_with_four_sessions()
    opened(link, 2, 2)
    assert (link.load, link.asked) == pytest.approx((0.3, 0.15))


def test_clips_do_not_add_to_the_load() -> None:
    link = link_with_four_sessions()
    opened(link, 2, 16, clip_frames=200)
    assert (link.load, link.asked) == (0.2, 0.1)
    link.take_pulse(Pulse(1, 0.0, (StepReport(load=0.2, asked=0.1),)))
    opened(link, 3, 4)
    assert (link.load, link.asked) == pytest.approx((0.4, 0.2)), "four more sessions; clips do not count"


def test_refused_and_closed_sessions_do_not_add_to_the_load() -> None:
    link = link_with_four_sessions()
    keys = opened(link, 2, 3)
    link.take_outputs([Outcome(keys[0], 1, Code.RESOURCE_EXHAUSTED)])
    link.take_outputs([Closed(keys[1], CloseReason.CLIENT, Code.OK, "", 0, 0)])
    assert (link.load, link.asked) == pytest.approx((0.25, 0.125)), "one of the three is left"


def test_end_of_a_reported_session_does_not_raise_the_load_of_others() -> None:
    link = link_with_four_sessions()
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
    link = link_with_four_sessions()
    link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 8.0}),)))
    keys, reached = opened(link, 2, 4), threading.Event()
    link._lock = WatchedLock(reached)  # type: ignore[assignment]
    read = SpecReadDuringReport(link, keys[0], reached)
    assert link.submit(Open(cast(SessionSpec, read), 2, 0.0)) is None
    read.thread.join(LIMIT_S)
    assert not link.refuses(Priority.NEAR, FACTS.default_steps)


def test_lost_engine_has_no_load() -> None:
    link = link_with_four_sessions()
    opened(link, 2, 2)
    link.lose(CloseReason.ENGINE_FAULT, "lost")
    assert (link.load, link.asked) == (0.0, 0.0)


def test_lost_engine_has_no_clips_and_no_new_sessions() -> None:
    link = link_with_four_sessions()
    opened(link, 2, 3, clip_frames=200)
    opened(link, 3, 2)
    link.lose(CloseReason.ENGINE_FAULT, "lost")
    assert (link.num_sessions, link.num_clips, link._ledger.num_new) == (0, 0, 0)


def test_clips_take_no_places_of_sessions() -> None:
    link = link_with_four_sessions()
    link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 1.0}),)))
    opened(link, 2, 16, clip_frames=200)
    assert not link.refuses(Priority.NEAR, FACTS.default_steps)
    opened(link, 3, 1)
    assert link.refuses(Priority.NEAR, FACTS.default_steps)


def test_only_a_session_that_closes_gives_up_a_place_and_only_once() -> None:
    """Otherwise a client that asks for clips and gives them up would have sessions sent to an engine that is full."""
    link = link_with_four_sessions()
    (clip,), (session,) = opened(link, 2, 1, clip_frames=200), opened(link, 3, 1)
    link.take_pulse(Pulse(1, 0.0, (StepReport(places={Priority.NEAR: 0.0}),)))
    for key in (clip, SessionKey(9, 9)):
        link.submit(Close(key, 2, 0.0, CloseReason.CLIENT))
    assert link.refuses(Priority.NEAR, FACTS.default_steps)
    for _ in range(2):
        link.submit(Close(session, 2, 0.0, CloseReason.CLIENT))
    assert not link.refuses(Priority.NEAR, FACTS.default_steps)
    opened(link, 4, 1)
    assert link.refuses(Priority.NEAR, FACTS.default_steps)
