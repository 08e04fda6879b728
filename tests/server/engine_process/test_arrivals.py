"""Closes overtake waiting events, and yet each ends the session that it is meant for."""

from __future__ import annotations

import itertools
import re

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from motiongen_server.engine.types import Close, Closed, CloseReason, Code, Event, Open, SessionKey, SetPlayState
from motiongen_server.engine_process.arrivals import Arrivals
from motiongen_server.engine_process.ledger import Ledger
from motiongen_server.engine_process.messages import CloseAhead, Events
from tests.server.engine_process.audience import KEY, close, opening, play, playhead

OTHER = SessionKey(1, 2)


def test_events_arrive_in_their_order() -> None:
    events = (opening(), play(2), opening(OTHER), play(3))
    arrivals = Arrivals()
    assert arrivals.in_order(Events(1, 1, events[:2])) == list(events[:2])
    assert arrivals.in_order(Events(1, 3, events[2:])) == list(events[2:])


def test_only_events_that_a_close_overtook_are_left_out() -> None:
    first, edit, later, again, last = opening(), play(2), play(2, OTHER), opening(), close(3)
    arrivals = Arrivals()
    assert arrivals.in_order(Events(1, 1, (first,))) == [first]
    assert arrivals.ahead(CloseAhead(1, last, opened=1, last=2)) == [last]
    assert arrivals.in_order(Events(1, 2, (edit, later, again))) == [later, again]


def test_close_that_arrives_before_its_open_follows_the_open() -> None:
    first, edit, last = opening(), play(2), close(3)
    arrivals = Arrivals()
    assert arrivals.ahead(CloseAhead(1, last, opened=1, last=2)) == []
    assert arrivals.in_order(Events(1, 1, (first, edit))) == [first, last]


def test_early_close_waits_for_its_open_behind_events_of_an_earlier_session() -> None:
    left, again, last = playhead(3), opening(), close(2)
    arrivals = Arrivals()
    assert arrivals.ahead(CloseAhead(1, last, opened=2, last=2)) == []
    assert arrivals.in_order(Events(1, 1, (left, again))) == [left, again, last]


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(st.sampled_from(["open", "edit", "close"]), max_size=40), st.data())
def test_sessions_begin_and_end_once_in_any_order_of_the_two_sockets(wishes: list[str], data: st.DataObject) -> None:
    """One key is opened, edited and closed over and over, and messages in transit arrive early or late."""
    ledger, arrivals = Ledger(), Arrivals()
    events: list[Events] = []
    closes: list[CloseAhead] = []
    heard: list[Event] = []
    seqs = itertools.count(2)
    is_open, num_edits = False, 0  # num_edits: of the session that is open

    def arrive(everything: bool) -> None:
        while (events or closes) and (everything or data.draw(st.booleans())):
            if closes and (not events or data.draw(st.booleans())):
                heard.extend(arrivals.ahead(closes.pop(0)))
            else:
                heard.extend(arrivals.in_order(events.pop(0)))

    for wish in wishes:
        if (wish == "open") == is_open:
            continue
        event = {"open": opening, "edit": lambda: play(next(seqs)), "close": lambda: close(next(seqs))}[wish]()
        waits = not ledger.goes_ahead(event)
        ledger.note(event)
        if waits:
            first, sent = ledger.number([event])
            events.append(Events(1, first, tuple(sent)))
        closes += [CloseAhead(1, *each) for each in ledger.take_closes()]
        arrive(everything=False)
        is_open, num_edits = wish != "close", num_edits + 1 if wish == "edit" else 0
        if not is_open:  # the key is used again only after the engine has reported the session's end
            arrive(everything=True)
            ledger.settle([Closed(KEY, CloseReason.CLIENT, Code.OK, "", 0, 0)])
    arrive(everything=True)
    letters = {Open: "o", SetPlayState: "e", Close: "c"}
    story = "".join(letters[type(event)] for event in heard)
    assert re.fullmatch("(oe*c)*(oe*)?", story), story
    assert story.count("o") == story.count("c") + is_open
    assert not is_open or len(story.rpartition("o")[2]) == num_edits
