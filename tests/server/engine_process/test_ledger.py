"""The gateway's ledger, step by step: every event gets its answer, exactly once."""

from __future__ import annotations

import pytest

from motiongen_server.engine.types import (
    Chunk,
    Closed,
    CloseReason,
    Code,
    Event,
    Opened,
    Outcome,
    Output,
    SessionKey,
)
from motiongen_server.engine_process.ledger import Ledger
from tests.server.engine_process.audience import KEY, close, opening, play, playhead

OTHER = SessionKey(1, 2)
OPENED = Opened(KEY, 1, 0, 40, 5, 4, "tiny", "stick", 20)


def closed(reason: CloseReason = CloseReason.CLIENT) -> Closed:
    return Closed(KEY, reason, Code.OK, "", 0, 0)


def outcome(seq: int, code: Code = Code.OK) -> Outcome:
    return Outcome(KEY, seq, code)


def noted(*events: Event, send: bool = True) -> Ledger:
    ledger = Ledger()
    for event in events:
        ledger.note(event)
    if send:
        ledger.number([event for event in events if not ledger.goes_ahead(event)])
    return ledger


def answers(outputs: list[Output]) -> list[tuple[int, str]]:
    return [(output.event_seq, output.code.name) for output in outputs if isinstance(output, Outcome)]


def test_answers_of_the_engine_are_passed_on_unchanged() -> None:
    ledger = noted(opening(), play(2), playhead(3))
    outputs: list[Output] = [OPENED, outcome(2), closed()]
    assert ledger.settle(outputs) == outputs
    assert len(ledger) == 0


def test_unanswered_events_are_cancelled_before_their_session_s_end() -> None:
    ledger = noted(opening(), play(2), play(3))
    settled = ledger.settle([OPENED, outcome(2), closed()])
    assert answers(settled) == [(2, "OK"), (3, "CANCELLED")]
    assert isinstance(settled[-1], Closed)


def test_close_of_an_unknown_session_is_sent_as_an_ordinary_event() -> None:
    ledger = noted(opening())
    assert ledger.goes_ahead(close(2))
    assert not ledger.goes_ahead(close(2, OTHER))
    late = close(2, OTHER)
    assert ledger.number([late]) == (2, [late])


def test_only_the_open_of_a_closing_session_is_still_sent() -> None:
    ledger = Ledger()
    events = [opening(), play(2), play(3)]
    for event in [*events, close(4)]:
        ledger.note(event)
    assert ledger.take_closes() == [], "the engine does not know the session yet"
    assert ledger.number(events) == (1, events[:1])
    ((sent, opened, last),) = ledger.take_closes()
    assert (sent.event_seq, opened, last) == (4, 1, 1)
    assert answers(ledger.settle([OPENED, closed()])) == [(2, "CANCELLED"), (3, "CANCELLED")]


@pytest.mark.parametrize("close_is_sent", [False, True])
def test_a_refused_open_leaves_nothing_unanswered(close_is_sent: bool) -> None:
    ledger = Ledger()
    for event in (opening(), play(2)):
        ledger.note(event)
    ledger.number([opening(), play(2)])  # sends both
    ledger.note(play(3))
    ledger.note(close(4))
    ledger.number([play(3)])  # held back, since the session is closing
    assert not close_is_sent or ledger.take_closes()
    settled = ledger.settle([outcome(1, Code.RESOURCE_EXHAUSTED), outcome(2, Code.NOT_FOUND)])
    if close_is_sent:
        settled += ledger.settle([outcome(4, Code.NOT_FOUND)])
    else:
        assert ledger.take_closes() == []
    assert sorted(seq for seq, _ in answers(settled)) == [1, 2, 3, 4]
    assert len(ledger) == 0
    assert ledger.end_all(CloseReason.ENGINE_FAULT, "") == []


@pytest.mark.parametrize("is_taken_before", [False, True])
@pytest.mark.parametrize(
    ("answer", "end"),
    [(outcome(1, Code.RESOURCE_EXHAUSTED), outcome(3, Code.NOT_FOUND)), (OPENED, closed())],
    ids=["refused", "opened"],
)
def test_event_waiting_to_be_sent_when_its_session_ends_is_answered_once(
    answer: Output, end: Output, is_taken_before: bool
) -> None:
    ledger = Ledger()
    ledger.note(opening())
    ledger.number([opening()])
    edit = play(2)
    ledger.note(edit)
    ledger.note(close(3))
    assert ledger.take_closes()
    settled = ledger.settle([answer])
    if is_taken_before:
        assert ledger.number([edit])[1] == []
    settled += ledger.settle([end])
    if not is_taken_before:
        assert ledger.number([edit])[1] == []
    assert [seq for seq, _ in answers(settled)].count(2) == 1
    again = play(2)
    assert ledger.number([again])[1] == [again], "this event is of another session"


def test_end_all_ends_every_session_and_answers_every_event() -> None:
    ledger = noted(opening(), play(2), opening(OTHER), play(2, OTHER))
    ledger.note(close(3, OTHER))
    ledger.settle([OPENED, Chunk(KEY, 1, 0, [0] * 12, 3)])  # type: ignore[arg-type]
    ended = ledger.end_all(CloseReason.ENGINE_FAULT, "gone")
    mine = [output for output in ended if output.session == KEY]
    assert answers(mine) == [(2, "CANCELLED")]
    assert mine[-1] == Closed(KEY, CloseReason.ENGINE_FAULT, Code.UNAVAILABLE, "gone", 12, 0)
    others = [output for output in ended if output.session == OTHER]
    assert answers(others) == [(1, "UNAVAILABLE"), (2, "CANCELLED"), (3, "CANCELLED")]
    assert isinstance(others[0], Outcome)
    assert others[0].retry_after_s is not None
    assert ledger.end_all(CloseReason.ENGINE_FAULT, "gone") == []


def test_session_after_end_all_starts_afresh() -> None:
    ledger = noted(opening(), play(2))
    ledger.end_all(CloseReason.ENGINE_FAULT, "gone")
    ledger.note(opening())
    assert ledger.number([opening()])[0] == 1
    assert ledger.settle([OPENED, closed()]) == [OPENED, closed()]


def test_events_behind_a_refused_open_do_not_count_for_the_next_session() -> None:
    """The engine may process it only after the client has heard of the refusal and opened its handle again."""
    ledger = noted(opening(), play(2))
    ledger.note(play(3))  # this one waits to be sent
    settled = ledger.settle([outcome(1, Code.RESOURCE_EXHAUSTED)])
    assert answers(settled) == [(1, "RESOURCE_EXHAUSTED"), (2, "CANCELLED"), (3, "CANCELLED")]
    ledger.note(opening())
    ledger.note(play(2))
    _, sent = ledger.number([play(3), opening(), play(2)])
    assert [event.event_seq for event in sent] == [1, 2]
    assert answers(ledger.settle([outcome(2, Code.NOT_FOUND), OPENED])) == []
    assert answers(ledger.settle([outcome(2)])) == [(2, "OK")]


@pytest.mark.parametrize("again", [play(2), close(2)])
def test_late_answer_to_a_close_does_not_count_for_the_next_session(again: Event) -> None:
    """The Open was refused while the Close was on its way, which makes the engine skip what came behind the Open."""
    ledger = noted(opening(), play(2))
    ledger.note(close(3))
    assert ledger.take_closes()
    settled = ledger.settle([outcome(1, Code.RESOURCE_EXHAUSTED)])
    assert answers(settled) == [(1, "RESOURCE_EXHAUSTED"), (2, "CANCELLED"), (3, "CANCELLED")]
    assert KEY not in ledger
    ledger.note(opening())
    ledger.note(again)
    assert answers(ledger.settle([outcome(3, Code.NOT_FOUND)])) == []
    assert answers(ledger.settle([OPENED, outcome(2)])) == [(2, "OK")]


def test_events_of_repeatedly_refused_sessions_are_answered_once() -> None:
    ledger = Ledger()
    for _ in range(2):
        ledger.note(opening())
        ledger.note(play(2))
        ledger.number([opening(), play(2)])
        ledger.note(close(3))
        assert ledger.take_closes()
        refused = answers(ledger.settle([outcome(1, Code.RESOURCE_EXHAUSTED)]))
        assert refused == [(1, "RESOURCE_EXHAUSTED"), (2, "CANCELLED"), (3, "CANCELLED")]
    # The first session's edit was overtaken by its close, so the engine skips it.
    late = [outcome(3, Code.NOT_FOUND), outcome(2, Code.NOT_FOUND), outcome(3, Code.NOT_FOUND)]
    assert ledger.settle([*late]) == []
    assert answers(ledger.settle([outcome(2, Code.NOT_FOUND)])) == [(2, "NOT_FOUND")], "not expected, so passed on"


@pytest.mark.parametrize("is_closing", [False, True])
def test_events_that_cross_the_end_of_their_session_are_answered_once(is_closing: bool) -> None:
    ledger = noted(opening(), play(2), play(3))
    ledger.settle([OPENED, outcome(2)])
    if is_closing:
        ledger.note(close(4))
        assert ledger.take_closes()
    settled = ledger.settle([closed(CloseReason.IDLE)])
    assert answers(settled) == [(3, "CANCELLED")]
    late: list[Output] = [outcome(3, Code.NOT_FOUND)]
    if is_closing:
        late.append(outcome(4, Code.NOT_FOUND))
    assert ledger.settle(late) == []
    ledger.note(opening())
    ledger.note(play(2))
    assert answers(ledger.settle([OPENED, outcome(2)])) == [(2, "OK")]


def test_late_answers_are_not_expected_any_more_once_the_next_session_is_open() -> None:
    """So an answer that an engine fails to give, for whatever reason, is not missed for the next session."""
    ledger = noted(opening(), play(2))
    ledger.settle([OPENED, closed(CloseReason.IDLE)])
    ledger.note(opening())
    ledger.note(play(2))
    assert answers(ledger.settle([OPENED, outcome(2)])) == [(2, "OK")]


def test_playhead_of_an_ended_session_is_not_taken_for_the_next_one_s_open() -> None:
    ledger = noted(opening())
    ledger.note(playhead(3))
    ledger.settle([OPENED, closed(CloseReason.IDLE)])
    ledger.note(opening())
    ledger.note(close(2))
    first, sent = ledger.number([playhead(3), opening()])
    assert (first, sent[-1].event_seq) == (2, 1), "otherwise the open is held back, and the session never ends"
    ((_, opened, last),) = ledger.take_closes()
    assert (opened, last) == (3, 3)
