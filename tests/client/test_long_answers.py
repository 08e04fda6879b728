"""Answers far longer than an honest server's: what the client keeps of them is bounded, and says what was left out."""

from __future__ import annotations

import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import EventRefused, MotionClient, Outcome, ProtocolViolation, convert
from motiongen_client.convert import answers
from motiongen_client.convert.answers import MOST_CHARACTERS, MOST_PLACEMENTS, MOST_WARNINGS, WARNINGS_LEFT_OUT
from motiongen_client.edit import Edit, EditBook
from motiongen_client.reopening import MOST_REOPENINGS
from tests.client.fake_server import FakeServer
from tests.client.line import Line, frames, open_anew, open_session

LONG = "x" * (1 << 20)
CUT = f"{LONG[:MOST_CHARACTERS]}… ({len(LONG) - MOST_CHARACTERS} more characters were left out)"


async def test_long_texts_of_a_refusal_are_cut_and_say_so(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("walk")
    refusal = session_pb2.EditOutcome(code=3, reason=LONG, message=LONG, field=LONG, allowed=LONG)
    refusal.other_servers.add(address=LONG, routing_key=LONG)
    server.refuse = lambda event: refusal if event.HasField("edit_prompts") else ""
    with pytest.raises(EventRefused) as refused:
        await session.set_prompt("run")
    kept = refused.value
    (other,) = kept.other_servers
    assert {kept.reason, kept.message, kept.field, kept.allowed, other.address, other.routing_key} == {CUT}
    assert len(str(kept)) < 5 * MOST_CHARACTERS


def test_texts_up_to_the_limit_are_kept_whole() -> None:
    whole = LONG[:MOST_CHARACTERS]
    assert convert.session_end(session_pb2.SessionClosed(message=whole)).message == whole
    assert convert.session_end(session_pb2.SessionClosed(message=LONG)).message == CUT


def test_names_of_an_opening_are_cut() -> None:
    opened = convert.opened(session_pb2.SessionOpened(session_id=LONG, rig_id=LONG, model_id=LONG))
    assert {opened.session_id, opened.rig_id, opened.model_id} == {CUT}


@pytest.mark.parametrize("surplus", [0, 1, 5000])
def test_last_of_too_many_warnings_says_how_many_were_left_out(surplus: int) -> None:
    said = [session_pb2.EventWarning(reason=LONG, message=LONG, field=LONG)] * MOST_WARNINGS
    said += [session_pb2.EventWarning()] * surplus
    outcome = convert.outcome(session_pb2.EditOutcome(warnings=said), "an edit")
    assert isinstance(outcome, Outcome)
    told = outcome.warnings
    assert {(each.reason, each.message, each.field) for each in told[:MOST_WARNINGS]} == {(CUT, CUT, CUT)}
    last = [(each.reason, each.message) for each in told[MOST_WARNINGS:]]
    expected = (WARNINGS_LEFT_OUT, f"{surplus} more warnings of the server were left out")
    assert last == ([expected] if surplus else [])


def test_too_many_placements_are_a_protocol_violation() -> None:
    placements = [motion_pb2.ConstraintPlacement(constraint_id=1)] * MOST_PLACEMENTS
    assert len(answers.placements(placements)) == MOST_PLACEMENTS
    for message in (session_pb2.EditOutcome(), session_pb2.SessionOpened()):
        message.placements.extend([*placements, placements[0]])
        with pytest.raises(ProtocolViolation, match=rf"{MOST_PLACEMENTS + 1} placements; at most {MOST_PLACEMENTS}"):
            convert.outcome(message, "it") if isinstance(message, session_pb2.EditOutcome) else convert.opened(message)


async def test_token_that_is_too_long_is_a_protocol_violation() -> None:
    await open_session(Line(), LONG[:MOST_CHARACTERS])
    with pytest.raises(ProtocolViolation, match=f"{MOST_CHARACTERS + 1} characters"):
        await open_session(Line(), LONG[: MOST_CHARACTERS + 1])


async def test_edit_announced_again_and_again_is_held_once_and_seen_with_its_first_frame() -> None:
    book, edit = EditBook(), Edit("an edit", 2, 0.0)
    book.add(edit)
    for valid_from in (50, 40, 60):
        book.plan([2] * 1000, valid_from)
    assert len(book._unseen) == 1
    book.receive(40, 1.0)
    assert edit.latency_s is None
    book.receive(41, 2.0)
    assert edit.latency_s == 2.0
    assert not book._unseen


async def test_latest_reopenings_are_remembered_and_all_are_counted() -> None:
    line = Line()
    session = await open_session(line, token="")
    for number in range(MOST_REOPENINGS + 3):
        for update in frames(1, session.playback.received_to - session._offset):
            session.hear(update)
        open_anew(session, line)
        assert session.stats.reopenings == number + 1
        assert len(session.reopenings) == min(number + 1, MOST_REOPENINGS)
    assert session.reopenings[-1].frame == session._offset
    assert len({each.frame for each in session.reopenings}) == MOST_REOPENINGS
