"""Unanswered events are sent again within the server's rate limit, and new events after them."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_client import Session, SessionEnded, convert
from motiongen_client.repeating import PERIOD_S
from tests.client.conftest import ManualClock
from tests.client.line import Line, answer, open_session, opened, said_since_opened
from tests.client.synthetic import catalog
from tests.client.waiting import until


@pytest.fixture
async def line(clock: ManualClock) -> Line:
    return Line()


@pytest.fixture
async def session(line: Line) -> Session:
    return await open_session(line)


def reconnect(session: Session, per_second: float) -> None:
    """Reconnect, and have the session resumed by a server with this rate limit, in events per second."""
    offered = catalog(100)
    offered.limits.max_events_per_second = per_second
    session.reattach(convert.catalog(offered))
    session.hear(opened())


def set_prompts_while_disconnected(session: Session, count: int) -> None:
    """Lose the connection, and set that many prompts meanwhile."""
    session.interrupt()
    for number in range(count):
        session.set_prompt(f"prompt {number}")


def numbers(line: Line) -> list[int]:
    """The numbers of the events sent since the session was resumed."""
    return [event.event_seq for event in said_since_opened(line)]


async def test_half_a_second_of_the_rate_is_resent_at_once_and_the_rest_paced(
    session: Session, line: Line, clock: ManualClock
) -> None:
    set_prompts_while_disconnected(session, 20)
    reconnect(session, 24.0)
    assert numbers(line) == list(range(2, 14))
    later = session.set_prompt("behind them")
    for told in (15, 17, 19, 21, 22):
        clock.advance(PERIOD_S)
        await until(lambda told=told: len(numbers(line)) >= told - 1)  # type: ignore[misc]
        assert numbers(line) == list(range(2, told + 1))
    session.set_prompt("at once")
    assert (later.event_seq, numbers(line)[-1]) == (22, 23)


async def test_all_events_are_resent_at_once_to_a_server_without_a_rate_limit(session: Session, line: Line) -> None:
    set_prompts_while_disconnected(session, 20)
    reconnect(session, 0.0)
    assert numbers(line) == list(range(2, 22))


async def test_resending_interrupted_by_a_loss_starts_again_with_unanswered_events(
    session: Session, line: Line, clock: ManualClock
) -> None:
    set_prompts_while_disconnected(session, 6)
    reconnect(session, 6.0)
    assert numbers(line) == [2, 3, 4]
    session.hear(answer(2, effective_frame=10))
    session.interrupt()
    said = len(line.said)
    clock.advance(PERIOD_S * 2)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert len(line.said) == said, "nothing is sent without a connection"
    reconnect(session, 6.0)
    assert numbers(line) == [3, 4, 5]


async def test_closing_while_resending_sends_the_rest_and_then_the_close(session: Session, line: Line) -> None:
    session.interrupt()
    edits = [session.set_prompt(f"prompt {number}") for number in range(6)]
    reconnect(session, 6.0)
    closing = asyncio.ensure_future(session.close())
    await until(lambda: line.said[-1].HasField("close"))
    assert numbers(line) == list(range(2, 9))
    session.interrupt()
    assert (await closing).reason == "client"
    with pytest.raises(SessionEnded):
        await edits[-1]


async def test_only_the_newest_of_unsent_velocities_is_sent(session: Session, line: Line) -> None:
    heard = session.set_velocity(0.5, 0.0)
    session.interrupt()
    first, second, third = (session.set_velocity(speed, 0.0) for speed in (1.0, 1.5, 2.0))
    prompt = session.set_prompt("a person runs")
    last = session.set_velocity(2.5, 0.0)
    reconnect(session, 50.0)
    said = [event.set_velocity.x for event in line.said[-4:]]
    assert said == [0.5, 2.0, 0.0, 2.5]
    assert [edit.event_seq for edit in (heard, third, prompt, last)] == numbers(line) == [2, 3, 4, 5]
    session.hear(answer(3, effective_frame=10))
    assert [(await edit).effective_frame for edit in (first, second, third)] == [10, 10, 10]
    assert not last.done()
    session.set_velocity(3.0, 0.0)
    assert line.said[-1].event_seq == 6, "the one before was sent"


async def test_all_merged_velocities_raise_when_the_session_ends(session: Session) -> None:
    session.interrupt()
    waiting = [asyncio.ensure_future(_answer_of(session, speed)) for speed in (1.0, 1.5, 2.0)]
    await asyncio.sleep(0)
    await session.close()
    for each in waiting:
        with pytest.raises(SessionEnded):
            await each


async def _answer_of(session: Session, speed: float) -> object:
    return await session.set_velocity(speed, 0.0)
