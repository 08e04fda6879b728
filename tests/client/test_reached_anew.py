"""What became of constraints, where sessions are opened anew and ids are used again: nobody waits for ever."""

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


async def test_of_an_edit_without_an_answer_what_has_passed_is_refused_and_the_rest_asked_for(
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


async def test_a_session_opened_anew_takes_no_edit_of_which_a_part_has_passed(session: Session, line: Line) -> None:
    """Its server would refuse it as a whole, but cannot be told of frames before its own."""
    open_anew(session, line)
    with pytest.raises(InvalidInput, match="frames still to come"):
        session.add_constraints([Waypoint(HORIZON - 1, 1.0, 2.0), Waypoint(900, 3.0, 4.0)])
    assert session.add_constraints([Waypoint(HORIZON, 1.0, 2.0), Waypoint(900, 3.0, 4.0)]).event_seq == 2


@pytest.mark.parametrize("is_taken", [True, False])
async def test_one_that_is_to_take_the_place_of_one_that_has_passed_is_waited_for(
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


async def test_one_that_was_refused_stays_so_where_another_in_its_place_is_refused_too(session: Session) -> None:
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
async def test_what_is_heard_before_a_replacement_is_answered_is_of_the_one_before(
    session: Session, is_added: bool
) -> None:
    """The one before may have had no answer itself when the other was sent."""
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    replacing = session.replace_constraint(*adding.constraint_ids, Waypoint(900, 1.0, 2.0))
    waiting = asyncio.ensure_future(session.constraint_reached(*adding.constraint_ids))
    await asyncio.sleep(0)
    if is_added:
        session.hear(answer(2, effective_frame=10))
        session.hear(told(1, 30))
    else:
        session.hear(answer(2, code=9, reason="FRAME_COMMITTED"))
    session.hear(answer(3, effective_frame=20))  # in one message with the answer before
    await replacing
    await asyncio.sleep(0)
    assert not waiting.done()
    session.hear(told(1, 900))
    assert (await waiting).frame == 900


async def test_one_that_has_passed_and_was_not_told_of_is_not_forgotten(session: Session, line: Line) -> None:
    """The line may be lost between an answer and the news of a target that the character has come to meanwhile."""
    passed = session.add_waypoint(1.0, 2.0, frame=20)
    session.hear(answer(2, effective_frame=10))
    session.playback.advance_to(30)
    session.add_waypoint(3.0, 4.0, frame=900)
    session.hear(answer(3, effective_frame=35))
    open_anew(session, line)
    with pytest.raises(EventRefused, match="its frames passed"):
        async with asyncio.timeout(5):
            await session.constraint_reached(*passed.constraint_ids)


async def test_what_is_told_again_behind_the_answer_of_a_replacement_is_of_the_one_before(
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
    session.interrupt()  # with the news of the first, and the answer of the second, under way
    session.reattach(convert.catalog(catalog(100)))
    for update in (opened(), answer(3, effective_frame=40), told(key, 30)):
        session.hear(update)
    await asyncio.sleep(0)
    assert not waiting.done()
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    session.hear(answer(1, code=5, reason="SESSION_NOT_KEPT"))
    assert [target.frame for target in line.said[-1].open.constraints] == [900 - HORIZON], "it is still asked for"
    session.hear(opened())
    session.hear(told(key, 900 - HORIZON))
    assert (await waiting).frame == 900
    assert called == [30, 900]


async def test_what_is_told_again_of_one_before_is_not_of_the_one_in_force_when_the_next_is_refused(line: Line) -> None:
    session = await open_session(line, TOKEN)
    for update in frames(1):
        session.hear(update)
    adding = session.add_waypoint(1.0, 2.0, frame=30)
    session.hear(answer(2, effective_frame=10))
    (key,) = adding.constraint_ids
    session.replace_constraint(key, Waypoint(900, 3.0, 4.0))
    session.interrupt()  # with the news of the first, and the answer of the second, under way
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


# ---- what is known no more


@pytest.fixture
def little_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reached, "MOST_KEPT", 4)


def add(session: Session, number: int, **what: object) -> tuple[int, ...]:
    """The ids of targets that are set one by one, each of which its server answers."""
    ids = []
    for frame in range(100, 100 + number):
        adding = session.add_waypoint(1.0, 2.0, frame=frame)
        session.hear(answer(adding.event_seq, **what))
        ids += adding.constraint_ids
    return tuple(ids)


@pytest.mark.usefixtures("little_memory")
async def test_who_asks_for_more_than_is_remembered_is_told_so(session: Session) -> None:
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
    assert (await waiting).frame == 100, "it still applied, however many were told of meanwhile"


@pytest.mark.usefixtures("little_memory")
async def test_so_it_is_with_refusals_and_with_what_has_passed(session: Session, line: Line) -> None:
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


@pytest.mark.usefixtures("little_memory")
async def test_what_is_forgotten_can_be_replaced_and_who_waits_hears_that_of_the_one_set_last(session: Session) -> None:
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
