"""A session whose server gives it up: unanswered events are sent again to the server that resumes it."""

from __future__ import annotations

import asyncio

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import convert
from motiongen_client.errors import InvalidInput
from motiongen_client.session import Session
from tests.client.conftest import ManualClock
from tests.client.line import TOKEN, Line, open_session, opened, said_since_opened
from tests.client.synthetic import catalog
from tests.client.waiting import until


@pytest.fixture
async def line() -> Line:
    return Line()


@pytest.fixture
async def session(line: Line) -> Session:
    """Open, and saved by its server."""
    session = await open_session(line)
    saved = session_pb2.SessionDurability(is_kept=True)
    session.hear(session_pb2.SessionUpdate(session=1, durability=saved, durable_seq=1))
    return session


@pytest.mark.parametrize("crosses", [False, True])
async def test_unanswered_edit_is_sent_again_when_the_session_is_resumed(
    session: Session, line: Line, crosses: bool
) -> None:
    edit = session.set_prompt("run")
    session.hear(
        session_pb2.SessionUpdate(
            session=1,
            closed=session_pb2.SessionClosed(
                reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=grpc.StatusCode.UNAVAILABLE.value[0]
            ),
        )
    )
    refusal = session_pb2.EditOutcome(event_seq=2, code=9, reason="SESSION_NOT_OPEN", message="no session is open")
    if crosses:
        session.hear(session_pb2.SessionUpdate(session=1, outcome=refusal))
    await until(lambda: line.said[-1].open.resume_token == TOKEN)
    if crosses:
        session.hear(session_pb2.SessionUpdate(session=1, outcome=refusal))
    assert line.said[-1].open.resume_point.answered_seq == 1
    session.hear(opened())
    assert line.said[-1].event_seq == 2
    assert line.said[-1].edit_prompts.upsert[0].text == "run"
    session.hear(session_pb2.SessionUpdate(session=1, outcome=session_pb2.EditOutcome(event_seq=2, effective_frame=4)))
    assert (await edit).effective_frame == 4


async def test_session_with_an_edit_too_big_to_repeat_is_closed_at_the_next_number(
    session: Session, line: Line, monkeypatch: pytest.MonkeyPatch
) -> None:
    too_big = InvalidInput("edit", "3000 bytes", "at most 2048")

    def check(event: session_pb2.SessionEvent) -> None:
        if event.ByteSize() > 2048:
            raise too_big

    session.interrupt()
    edits = [session.set_prompt("run"), session.set_prompt("x" * 3000)]
    monkeypatch.setattr(line, "check", check)  # this server accepts less
    session.reattach(convert.catalog(catalog(100)))
    session.hear(opened())
    said = said_since_opened(line)
    assert [(event.event_seq, event.WhichOneof("event")) for event in said] == [(2, "edit_prompts"), (3, "close")]
    for edit in edits:
        with pytest.raises(InvalidInput, match="3000 bytes"):
            await edit


async def test_resumed_session_has_the_denoising_steps_of_its_new_opening(session: Session, line: Line) -> None:
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    resumed = opened()
    resumed.opened.denoise_steps = 6  # what SetOptions asked for meanwhile
    session.hear(resumed)
    assert (session.service_level.tier, session.service_level.denoise_steps) == ("full", 6)


async def test_cut_made_while_disconnected_is_known_from_its_outcome(session: Session) -> None:
    session.teleport(5.0, 0.0)
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    session.hear(opened())
    plan = session_pb2.PlanNotice(plan=3, valid_from=0, cause=session_pb2.PLAN_CAUSE_RESUME, event_seqs=[2])
    session.hear(session_pb2.SessionUpdate(session=1, plan=plan))
    for _ in range(2):  # a server repeats it when the session is resumed again
        outcome = session_pb2.EditOutcome(event_seq=2, effective_frame=20)
        session.hear(session_pb2.SessionUpdate(session=1, outcome=outcome))
    assert [frame for frame in range(40) if session.playback.is_cut(frame)] == [20]
    assert session.playback.cut_before(30) == 20


@pytest.mark.parametrize("token", [TOKEN, ""])
async def test_session_given_up_is_closed_at_once_if_the_connection_is_lost_before_it_is_resumed(
    clock: ManualClock, line: Line, token: str
) -> None:
    session = await open_session(line, token)
    lost = session_pb2.SessionClosed(
        reason=session_pb2.CLOSE_REASON_ENGINE_FAULT, code=grpc.StatusCode.UNAVAILABLE.value[0]
    )
    session.hear(session_pb2.SessionUpdate(session=1, closed=lost))
    said = len(line.said)
    line.is_connected = False
    session.interrupt()
    clock.advance(60)  # long after the session would have been resumed
    for _ in range(10):
        await asyncio.sleep(0)
    closing = asyncio.create_task(session.close())
    await asyncio.sleep(0)
    assert closing.done(), "no server can answer, so none is awaited"
    assert "while the connection was lost" in closing.result().message
    assert len(line.said) == said
