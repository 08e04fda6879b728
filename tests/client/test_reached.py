"""What became of constraints, as the client reports it."""

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


async def test_constraint_outcome_is_awaited_called_back_once_and_remembered(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    called: list[ConstraintReached] = []
    session.on_constraint_reached = called.append
    edit = session.add_constraints([Waypoint(30, 1.0, 2.0, tolerance_m=0.5, tolerance_rad=0.25)])
    await edit
    waiting = asyncio.ensure_future(session.constraint_reached(edit.constraint_ids[0]))
    for _ in range(2):  # a server repeats it to a session that resumes
        server.stream.push(session.handle, constraint_reached=told(position_error_m=0.25))
    reached = await waiting
    assert reached == ConstraintReached(1, True, 30, 0.25, None)
    assert await session.constraint_reached(1) == reached
    await session.set_prompt("a person runs")  # answered after both
    assert called == [reached]
    (sent,) = [event for event in server.stream.received if event.HasField("edit_constraints")]
    constraint = sent.edit_constraints.upsert[0]
    assert (constraint.tolerance_m, constraint.tolerance_rad) == (0.5, 0.25)


async def test_second_outcome_with_the_same_id_is_called_back_too(client: MotionClient, server: FakeServer) -> None:
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


async def test_waiting_for_a_constraint_raises_when_the_session_ends(client: MotionClient) -> None:
    session = await client.open("a person walks")
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    await session.close()
    with pytest.raises(SessionEnded):
        await waiting
    with pytest.raises(SessionEnded):
        await session.constraint_reached(2)


async def test_heading_and_joint_rotations_are_sent_without_positions(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    await session.add_heading(0.0, frame=30)
    await session.add_constraints([JointRotations(31, [2, 3], [[1, 0, 0, 0], [0, 1, 0, 0]])])
    sent = [event.edit_constraints.upsert[0] for event in server.stream.received if event.HasField("edit_constraints")]
    assert [(each.frame, each.WhichOneof("target")) for each in sent] == [(30, "heading"), (31, "joint_rotations")]
    assert list(sent[1].joint_rotations.joints) == [2, 3]
    assert list(sent[1].joint_rotations.rotations) == [1, 0, 0, 0, 0, 1, 0, 0]


async def test_replacement_constraint_has_its_own_outcome(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    await session.add_waypoint(1, 2, frame=30)
    server.stream.push(session.handle, constraint_reached=told(30))
    assert (await session.constraint_reached(1)).frame == 30
    await session.replace_constraint(1, HeadingTarget(60, 1.0))
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    server.stream.push(session.handle, constraint_reached=told(60))
    assert (await waiting).frame == 60


async def test_repeated_outcome_is_not_taken_for_that_of_the_replacement(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    called: list[ConstraintReached] = []
    session.on_constraint_reached = called.append
    await session.add_waypoint(1, 2, frame=30)
    server.stream.push(session.handle, constraint_reached=told(30))
    await session.constraint_reached(1)
    await session.replace_constraint(1, HeadingTarget(60, 1.0))
    waiting = asyncio.ensure_future(session.constraint_reached(1))
    server.stream.push(session.handle, constraint_reached=told(30))  # repeated, as to a session that resumes
    server.stream.push(session.handle, constraint_reached=told(60))
    assert (await waiting).frame == 60
    assert [each.frame for each in called] == [30, 60]


@pytest.mark.parametrize("is_refused", [False, True])
async def test_outcome_that_crosses_a_replacement_belongs_to_the_replaced_constraint(
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
def test_joint_rotations_that_do_not_match_their_joints_are_refused(joints: list[int]) -> None:
    with pytest.raises(InvalidInput):
        JointRotations(30, joints, [[1, 0, 0, 0]])


@pytest.mark.parametrize("tolerance", [{"tolerance_m": -1.0}, {"tolerance_m": math.inf}, {"tolerance_rad": 4.0}])
def test_invalid_tolerance_is_refused(tolerance: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match="tolerance"):
        Waypoint(30, 1.0, 2.0, **tolerance)


async def test_waiting_for_a_refused_constraint_raises_the_refusal(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    server.refuse = lambda event: "FRAME_COMMITTED" if event.HasField("edit_constraints") else ""
    edit = session.add_waypoint(1.0, 2.0, frame=1)
    for _ in range(2):  # the caller that waits for the answer, and one that asks later
        with pytest.raises(EventRefused, match="FRAME_COMMITTED"):
            await session.constraint_reached(edit.constraint_ids[0])


async def test_outcome_stays_known_when_a_replacement_is_refused(client: MotionClient, server: FakeServer) -> None:
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


async def test_waiting_for_a_constraint_that_passed_while_disconnected_raises(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    early = session.add_waypoint(1.0, 2.0, frame=session.playback.playhead + 10)
    late = session.add_waypoint(1.0, 2.0, frame=100_000)
    await late
    waiting = asyncio.ensure_future(session.constraint_reached(late.constraint_ids[0]))
    server.stream.fail(grpc.StatusCode.UNAVAILABLE)  # and the server has not kept the session
    with pytest.raises(EventRefused, match="its frames passed"):
        await session.constraint_reached(early.constraint_ids[0])
    assert session.stats.reopenings == 1
    assert not waiting.done()
    await session.close()
    with pytest.raises(SessionEnded):
        await waiting
