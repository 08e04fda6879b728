"""What became of constraints of reopened sessions and of ids that are used again: no caller waits for ever."""

from __future__ import annotations

import asyncio

import pytest

from motiongen_client import EventRefused, InvalidInput, Session, Waypoint, convert, reached
from tests.client.line import TOKEN, Line, answer, frames, open_anew, open_session, open_with_frames, opened, told
from tests.client.synthetic import HORIZON, catalog


@pytest.fixture
async def line() -> Line:
    return Line()


@pytest.fixture
async def session(line: Line) -> Session:
    return await open_with_frames(line)


async def test_reopening_refuses_passed_constraints_of_an_edit_and_resends_the_rest(
    session: Session, line: Line
) -> None:
    edit = session.add_constraints([Waypoint(30, 1.0, 2.0), Waypoint(900, 3.0, 4.0)])
    passed, left = edit.constraint_ids
    waiting = [asyncio.ensure_future(session.constraint_reached(key)) for key in (passed, left)]
    await asyncio.sleep(0)
    open_anew(session, line)
    assert [(each.constraint_id, each.frame) for each in line.said[-1].edit_constraints.upsert] == [
        (left, 900 - HORIZON)
    ]
    with pytest.raises(EventRefused, match="its frames passed"):
        await waiting[0]
    with pytest.raises(EventRefused, match="its frames passed"):
        await session.constraint_reached(passed)
    session.hear(answer(2, effective_frame=4))
    await edit
    assert not waiting[1].done()
    session.hear(told(left, 900 - HORIZON))
    assert (await waiting[1]).frame == 900


async def test_reopened_session_refuses_an_edit_with_a_passed_constraint(session: Session, line: Line) -> None:
    """A server refuses such an edit as a whole, but a reopened session cannot send it frames before its first."""
    open_anew(session, line)
    with pytest.raises(InvalidInput, match="frames still to come"):
        session.add_constraints([Waypoint(HORIZON - 1, 1.0, 2.0), Waypoint(900, 3.0, 4.0)])
    assert session.add_constraints([Waypoint(HORIZON, 1.0, 2.0), Waypoint(900, 3.0, 4.0)]).event_seq == 2


@pytest.mark.parametrize("is_taken", [True, False])
async def test_pending_replacement_of_a_passed_constraint_is_waited_for(
    session: Session, line: Line, is_taken: bool
) -> None:
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    session.hear(answer(2, effective_frame=10))
    (key,) = (await adding) and adding.constraint_ids
    replacing = session.replace_constraint(key, Waypoint(900, 3.0, 4.0))
    waiting = asyncio.ensure_future(session.constraint_reached(key))
    await asyncio.sleep(0)
    open_anew(session, line)
    assert line.said[-1].edit_constraints.upsert[0].frame == 900 - HORIZON
    if not is_taken:
        session.hear(answer(2, code=3, reason="NO_WAY"))
        with pytest.raises(EventRefused, match="NO_WAY"):
            await replacing
        with pytest.raises(EventRefused, match="its frames passed"):
            await waiting
        return
    session.hear(answer(2, effective_frame=4))
    await replacing
    assert not waiting.done()
    session.hear(told(key, 900 - HORIZON))
    assert (await waiting).frame == 900
    assert (await session.constraint_reached(key)).frame == 900


async def test_waiting_for_a_refused_replacement_of_a_refused_constraint_raises(session: Session) -> None:
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    session.hear(answer(2, code=9, reason="FRAME_COMMITTED"))
    with pytest.raises(EventRefused):
        await session.constraint_reached(*adding.constraint_ids)
    replacing = session.replace_constraint(*adding.constraint_ids, Waypoint(40, 1.0, 2.0))
    waiting = asyncio.ensure_future(session.constraint_reached(*adding.constraint_ids))
    session.hear(answer(3, code=9, reason="FRAME_COMMITTED"))
    for edit in (adding, replacing):
        with pytest.raises(EventRefused):
            await edit
    with pytest.raises(EventRefused, match="FRAME_COMMITTED"):
        async with asyncio.timeout(5):
            await waiting


@pytest.mark.parametrize("is_added", [True, False])
async def test_outcome_before_the_answer_to_a_replacement_is_of_the_replaced_one(
    session: Session, is_added: bool
) -> None:
    """The replaced constraint may itself be unanswered when its replacement is sent."""
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    replacing = session.replace_constraint(*adding.constraint_ids, Waypoint(900, 1.0, 2.0))
    waiting = asyncio.ensure_future(session.constraint_reached(*adding.constraint_ids))
    await asyncio.sleep(0)
    if is_added:
        session.hear(answer(2, effective_frame=10))
        session.hear(told(1, 30))
    else:
        session.hear(answer(2, code=9, reason="FRAME_COMMITTED"))
    session.hear(answer(3, effective_frame=20))  # in the same message as the answer before
    await replacing
    await asyncio.sleep(0)
    assert not waiting.done()
    session.hear(told(1, 900))
    assert (await waiting).frame == 900


async def test_constraint_that_passed_without_an_outcome_is_refused_at_reopening(session: Session, line: Line) -> None:
    """The connection may be lost after the answer, and before the outcome of a target already reached arrives."""
    passed = session.add_waypoint(1.0, 2.0, frame=20)
    session.hear(answer(2, effective_frame=10))
    session.playback.advance_to(30)
    session.add_waypoint(3.0, 4.0, frame=900)
    session.hear(answer(3, effective_frame=35))
    open_anew(session, line)
    with pytest.raises(EventRefused, match="its frames passed"):
        async with asyncio.timeout(5):
            await session.constraint_reached(*passed.constraint_ids)


async def test_outcome_repeated_after_an_answered_replacement_is_of_the_replaced_one(
    line: Line,
) -> None:
    session = await open_session(line, TOKEN)
    for update in frames(1):
        session.hear(update)
    called: list[int] = []
    session.on_constraint_reached = lambda reached: called.append(reached.frame)
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    session.hear(answer(2, effective_frame=10))
    (key,) = adding.constraint_ids
    session.replace_constraint(key, Waypoint(900, 3.0, 4.0))
    waiting = asyncio.ensure_future(session.constraint_reached(key))
    await asyncio.sleep(0)
    session.interrupt()  # while the outcome of the first and the answer to the second are under way
    session.reattach(convert.catalog(catalog(100)))
    for update in (opened(), answer(3, effective_frame=40), told(key, 30)):
        session.hear(update)
    await asyncio.sleep(0)
    assert not waiting.done()
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    session.hear(answer(1, code=5, reason="SESSION_NOT_KEPT"))
    assert [target.frame for target in line.said[-1].open.constraints] == [900 - HORIZON], "it is still sent"
    session.hear(opened())
    session.hear(told(key, 900 - HORIZON))
    assert (await waiting).frame == 900
    assert called == [30, 900]


async def test_repeated_outcome_is_ignored_when_a_second_replacement_is_refused(line: Line) -> None:
    session = await open_session(line, TOKEN)
    for update in frames(1):
        session.hear(update)
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    session.hear(answer(2, effective_frame=10))
    (key,) = adding.constraint_ids
    session.replace_constraint(key, Waypoint(900, 3.0, 4.0))
    session.interrupt()  # while the outcome of the first and the answer to the second are under way
    session.reattach(convert.catalog(catalog(100)))
    for update in (opened(), answer(3, effective_frame=40)):
        session.hear(update)
    session.replace_constraint(key, Waypoint(50, 5.0, 6.0))
    waiting = asyncio.ensure_future(session.constraint_reached(key))
    await asyncio.sleep(0)
    session.hear(told(key, 30))
    session.hear(answer(4, code=9, reason="FRAME_COMMITTED"))
    await asyncio.sleep(0)
    assert not waiting.done(), "the second is in force, and still ahead"
    session.hear(told(key, 900))
    assert (await waiting).frame == 900


# ---- outcomes that are no longer remembered


@pytest.fixture
def few_outcomes_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reached, "MOST_KEPT", 4)


def add(session: Session, number: int, **what: object) -> tuple[int, ...]:
    """Set targets one by one, each answered by the server. Returns their ids."""
    ids = []
    for frame in range(100, 100 + number):
        adding = session.add_waypoint(1.0, 2.0, frame=frame)
        session.hear(answer(adding.event_seq, **what))
        ids += adding.constraint_ids
    return tuple(ids)


@pytest.mark.usefixtures("few_outcomes_kept")
async def test_only_the_newest_outcomes_are_remembered_and_older_ids_are_refused(session: Session) -> None:
    ahead, *over = add(session, 7, effective_frame=10)
    for key in over:
        session.hear(told(key, 100 + key))
    for key in over[:2]:
        with pytest.raises(InvalidInput, match=r"constraint_id: .* was given; allowed is .* the last 4; await it"):
            async with asyncio.timeout(5):
                await session.constraint_reached(key)
    for key in over[2:]:
        assert (await session.constraint_reached(key)).frame == 100 + key
    waiting = asyncio.ensure_future(session.constraint_reached(ahead))
    await asyncio.sleep(0)
    session.hear(told(ahead, 100))
    assert (await waiting).frame == 100, "it was still ahead, however many outcomes came meanwhile"


@pytest.mark.usefixtures("few_outcomes_kept")
async def test_only_the_newest_refused_and_passed_constraints_are_remembered(session: Session, line: Line) -> None:
    first, *_ = add(session, 5, code=9, reason="NO_WAY")
    passing = session.add_constraints([Waypoint(20 + number, 1.0, 2.0) for number in range(5)])
    session.hear(answer(passing.event_seq, effective_frame=10))
    open_anew(session, line)
    for key in (first, passing.constraint_ids[0]):
        with pytest.raises(InvalidInput, match="constraint_id"):
            async with asyncio.timeout(5):
                await session.constraint_reached(key)
    with pytest.raises(EventRefused, match="its frames passed"):
        await session.constraint_reached(passing.constraint_ids[-1])


@pytest.mark.usefixtures("few_outcomes_kept")
async def test_constraint_with_a_forgotten_outcome_can_be_replaced(session: Session) -> None:
    first, *over = add(session, 5, effective_frame=10)
    for key in (first, *over):
        session.hear(told(key, 100 + key))
    for is_taken in (True, False):
        replacing = session.replace_constraint(first, Waypoint(900, 3.0, 4.0))
        waiting = asyncio.ensure_future(session.constraint_reached(first))
        await asyncio.sleep(0)
        assert not waiting.done(), "it is being set"
        if is_taken:
            session.hear(answer(replacing.event_seq, effective_frame=20))
            session.hear(told(first, 900))
            assert (await waiting).frame == 900
            for key in add(session, 4, effective_frame=30):
                session.hear(told(key, 100 + key))
    session.hear(answer(replacing.event_seq, code=9, reason="NO_WAY"))
    with pytest.raises(InvalidInput, match="constraint_id"):
        async with asyncio.timeout(5):
            await waiting
