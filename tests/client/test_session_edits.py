"""Edits of a session: what is sent, which outcomes come back, and what a refusal says."""

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


async def test_new_prompt_replaces_frames_from_its_effective_frame_on(
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


async def test_prompts_that_have_passed_are_removed_by_the_next_edit(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    for frame, text in ((20, "two"), (40, "three")):
        await session.set_prompt(text, frame=frame)
    async for _ in session.frames(seconds=0.5):
        pass
    await session.set_prompt("four", frame=500)
    assert sorted(server.stream.characters[1].prompts.values()) == ["four", "one", "three"]
    await session.set_prompt("five")
    assert sorted(server.stream.characters[1].prompts.values()) == ["five", "four"]


@pytest.mark.parametrize("reason", ["PROMPT_TOO_LONG", "UNKNOWN_PROMPT"])
async def test_removals_of_a_refused_prompt_edit_are_repeated_unless_unknown(
    client: MotionClient, server: FakeServer, reason: str
) -> None:
    session = await client.open("one")
    await session.set_prompt("two", frame=20)
    async for _ in session.frames(seconds=0.5):
        pass
    server.refuse = lambda event: reason if event.HasField("edit_prompts") else ""
    for edit in (session.set_prompt("three"), session.remove_prompts([2])):
        with pytest.raises(EventRefused):
            await edit
    server.refuse = lambda event: ""
    await session.set_prompt("four")
    dropped = [list(event.edit_prompts.remove) for event in await received(server, "edit_prompts", 4)]
    assert dropped == [[], [2], [2], [] if reason == "UNKNOWN_PROMPT" else [2]]


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


async def test_awaited_refusal_raises_without_a_log_line_and_the_session_continues(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    server.refuse = lambda event: "BLANK_PROMPT" if event.WhichOneof("event") == "edit_prompts" else ""
    session = await client.open("a person walks")
    with caplog.at_level(logging.WARNING), pytest.raises(EventRefused, match="BLANK_PROMPT") as refusal:
        await session.set_prompt("  ")
    assert (refusal.value.code, refusal.value.field) == ("INVALID_ARGUMENT", "edit_prompts.x")
    assert refusal.value.allowed == "other things"
    assert caplog.text == "", "the caller that awaits it gets the exception"
    assert len([frame async for frame in session.frames(seconds=0.2)]) == 20


async def test_refusal_of_an_edit_that_is_not_awaited_is_logged(
    client: MotionClient, server: FakeServer, caplog: pytest.LogCaptureFixture
) -> None:
    server.refuse = lambda event: "BLANK_PROMPT" if event.WhichOneof("event") == "edit_prompts" else ""
    session = await client.open("a person walks")
    edit = session.set_prompt("  ")
    async for _ in session.frames(seconds=0.2):
        pass
    assert edit.done()
    assert "the prompt '  ' was refused with BLANK_PROMPT" in caplog.text


async def test_velocity_is_sent_in_metres_per_second_and_frames(client: MotionClient, server: FakeServer) -> None:
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
async def test_velocity_that_is_not_finite_or_too_long_is_refused_by_the_client(
    client: MotionClient, wrong: dict[str, float]
) -> None:
    session = await client.open("a person walks")
    with pytest.raises(InvalidInput, match="finite"):
        session.set_velocity(**{"x_mps": 0.0, "z_mps": 0.0, **wrong})
    with pytest.raises(InvalidInput, match="seconds"):
        session.set_velocity(0.0, 0.0, seconds=1e12)


async def test_refusal_says_when_to_retry(client: MotionClient, server: FakeServer) -> None:
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


async def test_refusal_names_the_edit_in_the_singular(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    server.refuse = lambda _: "OVERLOADED"  # type: ignore[method-assign]
    for edit, name in (
        (session.add_constraints([Waypoint(60, 1.0, 1.0), Waypoint(80, 1.0, 1.0)]), "the addition of constraints"),
        (session.set_constraints([]), "the replacement of all constraints"),
        (session.set_options(denoise_steps=4), "the change of options"),
    ):
        with pytest.raises(EventRefused, match=f"^{name} was refused with OVERLOADED"):
            await edit


async def test_latency_of_an_edit_beyond_the_plan_is_known_at_its_effective_frame(
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


async def test_prompt_with_an_end_can_be_moved_and_removed(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    wave = session.set_prompt("wave", frame=40, end_frame=60)
    await wave
    assert wave.prompt_id == 2
    again = session.set_prompt("wave", frame=80, end_frame=100, prompt_id=wave.prompt_id)
    await again
    await session.remove_prompts([2])
    assert server.stream.characters[session.handle].prompts == {1: "one"}
    sent = [event.edit_prompts for event in await received(server, "edit_prompts", 3)]
    spans = [(span.prompt_id, span.start_frame, span.end_frame) for edit in sent for span in edit.upsert]
    assert spans == [(2, 40, 60), (2, 80, 100)]
    assert list(sent[2].remove) == [2]


async def test_prompt_that_ended_by_itself_is_not_removed_by_the_next(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    await session.set_prompt("for a while", end_frame=10)
    async for _ in session.frames(seconds=0.2):
        pass
    await session.set_prompt("two")
    assert [list(event.edit_prompts.remove) for event in await received(server, "edit_prompts", 2)] == [[], []]


async def test_invalid_prompt_frames_and_unknown_ids_are_refused_by_the_client(client: MotionClient) -> None:
    session = await client.open("one")
    with pytest.raises(InvalidInput, match="later_prompts"):
        await client.open("one", later_prompts={-1: "two"})
    with pytest.raises(InvalidInput, match="later_prompts"):
        await client.generate_clip("one", num_frames=8, later_prompts={-1: "two"})
    with pytest.raises(InvalidInput, match="above 40"):
        session.set_prompt("two", frame=40, end_frame=40)
    with pytest.raises(InvalidInput, match="of an earlier Edit"):
        session.set_prompt("two", prompt_id=9)
    with pytest.raises(InvalidInput, match="of an earlier Edit"):
        session.replace_constraint(3, Waypoint(50, 0, 0))


async def test_constraint_is_replaced_by_its_id(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("one")
    (key,) = session.add_waypoint(1, 2, frame=30).constraint_ids
    edit = session.replace_constraint(key, Waypoint(50, 3, 4))
    await edit
    assert edit.constraint_ids == (key,)
    assert server.stream.characters[session.handle].constraint_ids == {key}
    sent = await received(server, "edit_constraints", 2)
    assert sent[1].edit_constraints.upsert[0].frame == 50


async def test_is_paused_follows_pause_and_resume(client: MotionClient) -> None:
    session = await client.open("one")
    assert not session.is_paused
    await session.pause()
    assert session.is_paused
    await session.resume()
    assert not session.is_paused


async def test_seek_is_sent_with_the_frame_and_frame_0_is_refused(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    assert (await session.seek(6)).effective_frame is not None
    (sent,) = await received(server, "seek")
    assert sent.seek == session_pb2.Seek(frame=6)
    with pytest.raises(InvalidInput, match="none is before the first"):
        session.seek(0)
