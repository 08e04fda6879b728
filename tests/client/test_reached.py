"""What became of constraints, as the client tells it."""

from __future__ import annotations

import asyncio
import math

import grpc
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    ConstraintReached,
    EventRefused,
    HeadingTarget,
    InvalidInput,
    JointRotations,
    MotionClient,
    SessionEnded,
    Waypoint,
)
from tests.client.fake_server import FakeServer


def told(frame: int = 30, met: bool = True, **errors: float) -> session_pb2.ConstraintReached:
    return session_pb2.ConstraintReached(constraint_id=1, met=met, frame=frame, **errors)


async def test_it_is_waited_for_called_back_and_kept(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    called: list[ConstraintReached] = []
    session.on_constraint_reached = called.append
    edit = session.add_constraints([Waypoint(30, 1.0, 2.0, tolerance_m=0.5, tolerance_rad=0.25)])
    await edit
    waiting = asyncio.ensure_future(session.constraint_reached(edit.constraint_ids[0]))
    for _ in range(2):  # a server tells it again to a session that resumes
        server.stream.push(session.handle, constraint_reached=told(position_error_m=0.25))
    reached = await waiting
    assert reached == ConstraintReached(1, True, 30, 0.25, None)
    assert await session.constraint_reached(1) == reached
    await session.set_prompt("a person runs")  # answered after both
    assert called == [reached]
    (sent,) = [event for event in server.stream.received if event.HasField("edit_constraints")]
    constraint = sent.edit_constraints.upsert[0]
    assert (constraint.tolerance_m, constraint.tolerance_rad) == (0.5, 0.25)


async def test_an_id_that_is_used_again_has_news_again(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    called: list[ConstraintReached] = []
    session.on_constraint_reached = called.append
    server.stream.push(session.handle, constraint_reached=told(30))
    server.stream.push(session.handle, constraint_reached=told(60, met=False, rotation_error_rad=1.5))
    await session.set_prompt("a person runs")
    assert [(reached.frame, reached.met, reached.rotation_error_rad) for reached in called] == [
        (30, True, None),
        (60, False, 1.5),
    ]


async def test_a_session_that_ends_tells_who_waits(client: MotionClient) -> None:
    session = await client.open("a person walks")
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    await session.close()
    with pytest.raises(SessionEnded):
        await waiting
    with pytest.raises(SessionEnded):
        await session.constraint_reached(2)


async def test_a_heading_and_rotations_are_sent_without_a_place(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    await session.add_heading(0.0, frame=30)
    await session.add_constraints([JointRotations(31, [2, 3], [[1, 0, 0, 0], [0, 1, 0, 0]])])
    sent = [event.edit_constraints.upsert[0] for event in server.stream.received if event.HasField("edit_constraints")]
    assert [(each.frame, each.WhichOneof("target")) for each in sent] == [(30, "heading"), (31, "joint_rotations")]
    assert list(sent[1].joint_rotations.joints) == [2, 3]
    assert list(sent[1].joint_rotations.rotations) == [1, 0, 0, 0, 0, 1, 0, 0]


async def test_a_constraint_that_takes_the_place_of_another_has_news_of_its_own(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    await session.add_waypoint(1, 2, frame=30)
    server.stream.push(session.handle, constraint_reached=told(30))
    assert (await session.constraint_reached(1)).frame == 30
    await session.replace_constraint(1, HeadingTarget(60, 1.0))
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    server.stream.push(session.handle, constraint_reached=told(60))
    assert (await waiting).frame == 60


async def test_old_news_is_not_of_the_constraint_that_has_the_id_now(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    called: list[ConstraintReached] = []
    session.on_constraint_reached = called.append
    await session.add_waypoint(1, 2, frame=30)
    server.stream.push(session.handle, constraint_reached=told(30))
    await session.constraint_reached(1)
    await session.replace_constraint(1, HeadingTarget(60, 1.0))
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    server.stream.push(session.handle, constraint_reached=told(30))  # told again, to a session that resumes
    server.stream.push(session.handle, constraint_reached=told(60))
    assert (await waiting).frame == 60
    assert [each.frame for each in called] == [30, 60]


@pytest.mark.parametrize("is_refused", [False, True])
async def test_news_that_crosses_a_replacement_is_of_the_one_before(
    client: MotionClient, server: FakeServer, is_refused: bool
) -> None:
    session = await client.open("a person walks")
    await session.add_waypoint(1, 2, frame=30)

    def refuse(event: session_pb2.SessionEvent) -> str:
        if event.HasField("edit_constraints"):
            server.stream.push(session.handle, constraint_reached=told(30))
        return "FRAME_COMMITTED" if is_refused and event.HasField("edit_constraints") else ""

    server.refuse = refuse
    edit = session.replace_constraint(1, Waypoint(60, 1.0, 2.0))
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    if is_refused:
        with pytest.raises(EventRefused):
            await edit
        assert (await waiting).frame == 30
        return
    await edit
    await session.set_prompt("a person runs")
    assert not waiting.done()
    server.stream.push(session.handle, constraint_reached=told(60))
    assert (await waiting).frame == 60


@pytest.mark.parametrize("joints", [[], [1, 2]])
def test_rotations_that_do_not_fit_their_joints_are_refused_here(joints: list[int]) -> None:
    with pytest.raises(InvalidInput):
        JointRotations(30, joints, [[1, 0, 0, 0]])


@pytest.mark.parametrize("tolerance", [{"tolerance_m": -1.0}, {"tolerance_m": math.inf}, {"tolerance_rad": 4.0}])
def test_a_tolerance_that_cannot_be_is_refused_here(tolerance: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match="tolerance"):
        Waypoint(30, 1.0, 2.0, **tolerance)


async def test_one_that_was_refused_is_not_waited_for(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.refuse = lambda event: "FRAME_COMMITTED" if event.HasField("edit_constraints") else ""
    edit = session.add_waypoint(1.0, 2.0, frame=1)
    for _ in range(2):  # who waits for the answer, and who asks later
        with pytest.raises(EventRefused, match="FRAME_COMMITTED"):
            await session.constraint_reached(edit.constraint_ids[0])


async def test_what_became_of_one_stays_known_where_another_does_not_take_its_place(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    edit = session.add_waypoint(1.0, 2.0, frame=30)
    await edit
    server.stream.push(session.handle, constraint_reached=told(30))
    reached = await session.constraint_reached(edit.constraint_ids[0])
    server.refuse = lambda event: "FRAME_COMMITTED" if event.HasField("edit_constraints") else ""
    with pytest.raises(EventRefused):
        await session.replace_constraint(reached.constraint_id, Waypoint(31, 1.0, 2.0))
    async with asyncio.timeout(5):
        assert await session.constraint_reached(reached.constraint_id) == reached


async def test_one_whose_frames_passed_while_the_line_was_lost_is_not_waited_for(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    early = session.add_waypoint(1.0, 2.0, frame=session.playback.playhead + 10)
    late = session.add_waypoint(1.0, 2.0, frame=100_000)
    await late
    waiting = asyncio.ensure_future(session.constraint_reached(late.constraint_ids[0]))
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)  # and the server has kept nothing
    with pytest.raises(EventRefused, match="its frames passed"):
        await session.constraint_reached(early.constraint_ids[0])
    assert session.stats.reopenings == 1
    assert not waiting.done()
    await session.close()
    with pytest.raises(SessionEnded):
        await waiting
