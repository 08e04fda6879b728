"""What the gateway takes to be in use of an engine since that last told."""

from __future__ import annotations

from dataclasses import replace

import pytest

from motiongen_server.engine.types import Closed, CloseReason, Code, Open, Outcome, Priority, SessionKey
from motiongen_server.engine.types.report import StepReport
from motiongen_server.engine_process.messages import Pulse, Ready
from motiongen_server.engine_process.model_link import ModelLink
from motiongen_server.rpc.abilities import NOTHING_CLAIMED
from tests.server.engine.fakes import FACTS
from tests.server.engine.stage import spec


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


def test_a_lost_engine_is_in_use_by_nobody() -> None:
    link = told_of_four()
    opened(link, 2, 2)
    link.lose(CloseReason.ENGINE_FAULT, "lost")
    assert (link.load, link.asked) == (0.0, 0.0)
