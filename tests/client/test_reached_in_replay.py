"""Outcomes of constraints after a session resumes: of the one that has the id now, or of one that it replaced."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

from motiongen_client import ConstraintReached, Flexible, RootTrajectory, Waypoint, convert
from motiongen_client.session import Session
from motiongen_client.types import Constraint
from tests.client.line import TOKEN, Line, answer, frames, open_session, opened, told
from tests.client.synthetic import HORIZON, catalog

FORMER_AT, TAKES_EFFECT_AT = 10, 20

RANGE = Flexible(Waypoint(5, 3.0, 4.0), last_frame=900)
TRAJECTORY = RootTrajectory(5, np.zeros((56, 2)))


@pytest.fixture
async def session() -> Session:
    """An open session with a constraint of id 1 at FORMER_AT."""
    session = await open_session(Line(), TOKEN)
    for update in frames(1):
        session.hear(update)
    session.add_waypoint(1.0, 2.0, frame=FORMER_AT)
    session.hear(answer(2, effective_frame=5))
    return session


def resume(session: Session) -> None:
    session.interrupt()
    session.reattach(convert.catalog(catalog(100)))
    session.hear(opened())


async def outcome_so_far(session: Session) -> asyncio.Future[ConstraintReached]:
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    return waiting


@pytest.mark.parametrize(
    ("replacement", "reported_at"), [(RANGE, 25), (RANGE, 900), (TRAJECTORY, 60), (Waypoint(FORMER_AT - 2, 0, 0), 8)]
)
async def test_outcome_at_a_frame_not_of_the_replacement_is_of_the_replaced_one(
    session: Session, replacement: Constraint, reported_at: int
) -> None:
    called: list[int] = []
    session.on_constraint_reached = lambda reached: called.append(reached.frame)
    session.replace_constraint(1, replacement)
    resume(session)
    session.hear(answer(3, effective_frame=TAKES_EFFECT_AT))
    session.hear(told(1, FORMER_AT))
    waiting = await outcome_so_far(session)
    assert not waiting.done()
    session.hear(told(1, reported_at))
    assert (await waiting).frame == reported_at
    assert called == [FORMER_AT, reported_at]


async def test_outcome_is_of_the_replaced_one_if_the_connection_was_lost_again_before_it_came(session: Session) -> None:
    """The answer came on the call before, so this server tells of the constraint alone."""
    session.replace_constraint(1, RANGE)
    resume(session)
    session.hear(answer(3, effective_frame=TAKES_EFFECT_AT))
    resume(session)
    session.hear(told(1, FORMER_AT))
    waiting = await outcome_so_far(session)
    assert not waiting.done()
    session.hear(told(1, TAKES_EFFECT_AT + 1))
    assert (await waiting).frame == TAKES_EFFECT_AT + 1


async def test_outcome_after_new_frames_is_of_the_replacement(session: Session) -> None:
    """The nearest frame may be before the replacement takes effect; no outcome of the replaced one can still come."""
    session.replace_constraint(1, RANGE)
    resume(session)
    session.hear(answer(3, effective_frame=TAKES_EFFECT_AT))
    for update in frames(2, HORIZON):
        session.hear(update)
    session.hear(told(1, TAKES_EFFECT_AT - 1))
    assert (await outcome_so_far(session)).result().frame == TAKES_EFFECT_AT - 1


async def test_outcome_is_of_a_replacement_answered_before_the_loss(session: Session) -> None:
    session.replace_constraint(1, RANGE)
    session.hear(answer(3, effective_frame=TAKES_EFFECT_AT))
    resume(session)
    session.hear(told(1, TAKES_EFFECT_AT - 1))
    assert (await outcome_so_far(session)).result().frame == TAKES_EFFECT_AT - 1


async def test_outcome_of_a_replaced_constraint_ends_no_wait_for_its_replacement(session: Session) -> None:
    session.replace_constraint(1, RANGE)
    resume(session)
    session.hear(answer(3, effective_frame=TAKES_EFFECT_AT))
    session.replace_constraint(1, Waypoint(50, 0, 0))
    session.hear(told(1, FORMER_AT))
    session.hear(answer(4, code=9, reason="FRAME_COMMITTED"))
    assert not (await outcome_so_far(session)).done(), "the replacement is in force, and still ahead"
