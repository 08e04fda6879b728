"""Edits of a session: what is sent, what comes back, and what a refusal says."""

from __future__ import annotations

import logging
import math

import numpy as np
import pytest

from motiongen.v1 import session_pb2
from motiongen_client import (
    EventRefused,
    InvalidInput,
    MotionClient,
    Waypoint,
)
from tests.client.conftest import ManualClock
from tests.client.fake_server import FakeServer
from tests.client.waiting import play, received


async def test_a_new_prompt_replaces_what_was_not_played_and_says_from_where(
    clock: ManualClock, client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks", keep_s=None)
    edit = None
    async for frame in play(session, clock, 1):
        if frame.index == 20:
            edit = session.set_prompt("a person runs")
            clock.advance(0.005)
            await edit
    assert edit is not None
    outcome = await edit
    assert outcome.effective_frame is not None
    plans = session.motion().root_translation_m[:, 0]
    assert outcome.effective_frame > 20
    assert plans[outcome.effective_frame] > plans[outcome.effective_frame - 1]
    assert edit.latency_s == pytest.approx(0.005)
    assert server.stream.characters[session.handle].prompts == {1: "a person runs"}


async def test_scheduled_prompts_that_have_passed_make_room(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    for frame, text in ((20, "two"), (40, "three")):
        await session.set_prompt(text, frame=frame)
    async for _ in session.frames(seconds=0.5):
        pass
    await session.set_prompt("four", frame=500)
    assert sorted(server.stream.characters[1].prompts.values()) == ["four", "one", "three"]
    await session.set_prompt("five")
    assert sorted(server.stream.characters[1].prompts.values()) == ["five", "four"]


async def test_constraints_are_added_replaced_and_removed_by_id(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    first = session.add_waypoint(1, 2, frame=30)
    second = session.add_trajectory(np.zeros((3, 2)), first_frame=40)
    await second
    character = server.stream.characters[session.handle]
    assert (first.constraint_ids, second.constraint_ids) == ((1,), (2,))
    assert character.constraint_ids == {1, 2}
    await session.remove_constraints(first.constraint_ids)
    assert character.constraint_ids == {2}
    await session.set_constraints([Waypoint(50, 0, 0), Waypoint(60, 0, 0)])
    assert character.constraint_ids == {3, 4}
    await session.clear_constraints()
    assert character.constraint_ids == set()


async def test_a_refusal_raises_where_awaited_and_the_session_goes_on(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    server.refuse = lambda event: "BLANK_PROMPT" if event.WhichOneof("event") == "edit_prompts" else ""
    session = await client.open("a person walks")
    with caplog.at_level(logging.WARNING), pytest.raises(EventRefused, match="BLANK_PROMPT") as refusal:
        await session.set_prompt("  ")
    assert (refusal.value.code, refusal.value.field) == ("INVALID_ARGUMENT", "edit_prompts.x")
    assert refusal.value.allowed == "other things"
    assert "BLANK_PROMPT" in caplog.text
    assert len([frame async for frame in session.frames(seconds=0.2)]) == 20


async def test_a_velocity_is_sent_in_metres_a_second_and_frames(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    outcome = await session.set_velocity(1.5, -0.5, seconds=0.25, heading_rad=0.0)
    (event,) = await received(server, "set_velocity")
    velocity = event.set_velocity
    assert (velocity.x, velocity.z, velocity.hold_frames) == (1.5, -0.5, 25)
    assert velocity.HasField("heading")
    assert outcome.effective_frame is not None
    await session.set_velocity(0, 0)
    assert not server.stream.received[-1].set_velocity.HasField("heading")


@pytest.mark.parametrize("wrong", [{"x_mps": math.nan}, {"z_mps": math.inf}, {"seconds": math.nan}])
async def test_a_velocity_that_is_no_number_is_refused_here(client: MotionClient, wrong: dict[str, float]) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="finite"):
        session.set_velocity(**{"x_mps": 0.0, "z_mps": 0.0, **wrong})


async def test_a_refusal_says_when_to_ask_again(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    refusal = session_pb2.EditOutcome(event_seq=2, code=8, reason="OVERLOADED", message="full")
    refusal.retry_after.FromMilliseconds(1500)

    def refuse_later(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") == "edit_prompts":
            server.stream.push(event.session, outcome=refusal)
            return "ANSWERED"
        return ""

    server.refuse = refuse_later
    with pytest.raises(EventRefused, match=r"try again in 1\.5 s") as refused:
        await session.set_prompt("a person runs")
    assert refused.value.retry_after_s == 1.5


async def test_an_edit_beyond_everything_planned_is_timed_by_its_effective_frame(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")

    def accept_at_120(event: session_pb2.SessionEvent) -> str:
        if event.WhichOneof("event") != "edit_constraints":
            return ""
        accepted = session_pb2.EditOutcome(event_seq=event.event_seq, effective_frame=120)
        server.stream.push(event.session, outcome=accepted)
        return "ANSWERED"  # the second answer to the same event, which a client drops

    server.refuse = accept_at_120
    edit = session.add_waypoint(1, 2, frame=120)
    assert (await edit).effective_frame == 120
    assert edit.latency_s is None
    async for _ in session.frames(seconds=1.3, realtime=False):
        pass
    assert edit.latency_s is not None
