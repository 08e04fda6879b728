"""What a client needs to find its way back: delays, what a session was told, and frames counted from elsewhere."""

from __future__ import annotations

import asyncio

import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_client import EventRefused, InvalidInput, LinePolicy, MotionClient, Priority, SessionOptions, convert
from motiongen_client.backoff import FIRST_DELAY_S, LONGEST_DELAY_S, LONGEST_SOON_DELAY_S, SOON_S, Backoff
from motiongen_client.frame_shift import shifted
from motiongen_client.wishes import Wishes
from tests.client.fake_server import FakeServer, FakeStream
from tests.client.waiting import received, until


def span(prompt_id: int, text: str, start: int = 0, end: int = 0) -> motion_pb2.PromptSpan:
    return motion_pb2.PromptSpan(prompt_id=prompt_id, text=text, start_frame=start, end_frame=end)


def prompts(*upsert: motion_pb2.PromptSpan, remove: tuple[int, ...] = ()) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_prompts=session_pb2.EditPrompts(upsert=upsert, remove=remove))


def waypoint(constraint_id: int, frame: int) -> motion_pb2.Constraint:
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, waypoint=motion_pb2.Waypoint(x=1))


def path(constraint_id: int, frame: int, length: int) -> motion_pb2.Constraint:
    positions = [float(number) for number in range(2 * length)]
    target = motion_pb2.RootTrajectory(positions=positions, headings=positions[:length])
    return motion_pb2.Constraint(constraint_id=constraint_id, frame=frame, root_trajectory=target)


def constraints(*upsert: motion_pb2.Constraint, clear: bool = False) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(edit_constraints=session_pb2.EditConstraints(upsert=upsert, clear=clear))


def test_delays_grow_to_a_longest_one_and_begin_anew() -> None:
    backoff = Backoff(lambda: 1.0)
    delays = [backoff.next_s() for _ in range(24)]
    assert delays[0] == FIRST_DELAY_S
    assert delays == sorted(delays)
    assert delays[-1] == LONGEST_DELAY_S
    soon = [delay for number, delay in enumerate(delays) if sum(delays[:number]) < SOON_S]
    assert max(soon) == LONGEST_SOON_DELAY_S
    backoff.reset()
    assert backoff.next_s() == FIRST_DELAY_S
    assert backoff.next_s(7.0) == 7.0, "the server asked for more"


def test_delays_differ_from_client_to_client() -> None:
    assert Backoff(lambda: 0.0).next_s() == FIRST_DELAY_S / 2
    assert len({Backoff().next_s() for _ in range(20)}) > 10


@pytest.mark.parametrize("wrong", [{"recover_s": -1}, {"ping_s": 0}, {"pong_timeout_s": 0}, {"hello_timeout_s": -1}])
def test_a_policy_that_cannot_be_is_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        LinePolicy(**wrong)


def test_a_prompt_that_has_begun_holds_from_the_beginning_and_one_that_has_ended_not_at_all() -> None:
    moved = shifted(prompts(span(1, "now"), span(2, "then", 30, 90), span(3, "over", 0, 20)), 40)
    assert moved is not None
    assert [(each.text, each.start_frame, each.end_frame) for each in moved.edit_prompts.upsert] == [
        ("now", 0, 0),
        ("then", 0, 50),
    ]


def test_constraints_that_have_passed_are_left_out_and_a_path_that_has_begun_is_cut() -> None:
    moved = shifted(constraints(waypoint(1, 30), waypoint(2, 50), path(3, 36, 10), path(4, 20, 10)), 40)
    assert moved is not None
    left = {each.constraint_id: each for each in moved.edit_constraints.upsert}
    assert {key: each.frame for key, each in left.items()} == {2: 10, 3: 0}
    assert list(left[3].root_trajectory.positions[:2]) == [8, 9]
    assert list(left[3].root_trajectory.headings) == [4, 5, 6, 7, 8, 9]


def test_an_event_of_which_nothing_is_left_is_none() -> None:
    assert shifted(constraints(waypoint(1, 30)), 40) is None
    assert shifted(prompts(span(1, "over", 0, 40)), 40) is None
    assert shifted(constraints(clear=True), 40) is not None
    assert shifted(prompts(remove=(1,)), 40) is not None


def test_the_prompt_in_force_comes_last_of_those_that_have_begun() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(prompts=[span(1, "first"), span(2, "later", 30)]))
    wishes.take(prompts(span(3, "much later", 100)), 100, 0)
    wishes.take(prompts(span(1, "second")), 20, 10)
    assert [(each.text, each.start_frame) for each in wishes.prompts_from(50, 16)] == [
        ("second", 0),
        ("later", 0),
        ("much later", 50),
    ]
    wishes.take(prompts(remove=(2,)), 60, 55)
    assert [each.text for each in wishes.prompts_from(60, 16)] == ["second", "much later"]


def spans_from(wishes: Wishes, frame: int, most: int = 16) -> list[tuple[str, int, int]]:
    return [(each.text, each.start_frame, each.end_frame) for each in wishes.prompts_from(frame, most)]


def test_a_prompt_that_has_begun_goes_on_until_the_one_in_its_place() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(prompts=[span(1, "walk")]))
    wishes.take(prompts(span(1, "run", 200)), 200, 10)
    assert spans_from(wishes, 150) == [("walk", 0, 50), ("run", 50, 0)]
    assert spans_from(wishes, 150, 1) == [("run", 50, 0)], "what may be said is less"
    assert spans_from(wishes, 200) == [("run", 0, 0)]
    wishes.take(prompts(span(1, "jump", 300)), 300, 20)  # "run" never began
    assert spans_from(wishes, 150) == [("walk", 0, 150), ("jump", 150, 0)]
    wishes.take(prompts(span(1, "sit")), 40, 30)
    assert spans_from(wishes, 35) == [("walk", 0, 5), ("sit", 5, 0)], "the answer names a frame that is to come"
    wishes.take(prompts(span(2, "wave", 50, 60)), 50, 45)
    wishes.take(prompts(span(3, "nod", 80, 90)), 80, 70)
    assert spans_from(wishes, 50) == [("sit", 0, 0), ("nod", 30, 40)], "what has ended is forgotten"


def test_constraints_are_those_that_stand_and_what_is_past_is_forgotten() -> None:
    wishes = Wishes()
    wishes.take_opening(session_pb2.OpenSession(constraints=[waypoint(1, 20), waypoint(2, 90)]))
    wishes.take(constraints(waypoint(3, 70)), 60, 50)
    assert [(each.constraint_id, each.frame) for each in wishes.constraints_from(60)] == [(2, 30), (3, 10)]
    wishes.take(constraints(clear=True), 60, 50)
    assert wishes.constraints_from(0) == []


def test_a_velocity_is_told_again_for_what_is_left_of_it_and_a_pause_too() -> None:
    wishes = Wishes()
    velocity = session_pb2.SetVelocity(x=1, hold_frames=20)
    wishes.take(session_pb2.SessionEvent(set_velocity=velocity), 40, 30)
    (told,) = wishes.events_from(50)
    assert (told.set_velocity.x, told.set_velocity.hold_frames) == (1, 10)
    assert wishes.events_from(60) == []
    pause = session_pb2.SetPlayState(state=session_pb2.PLAY_STATE_PAUSED)
    wishes.take(session_pb2.SessionEvent(set_play_state=pause), 40, 30)
    assert [event.WhichOneof("event") for event in wishes.events_from(60)] == ["set_play_state"]


async def test_a_server_that_starts_later_is_waited_for() -> None:
    server = FakeServer()  # its port is taken, but nobody answers there
    connecting = asyncio.create_task(MotionClient(server.address, connect_timeout_s=60).connect())
    await asyncio.sleep(0)
    with server:
        client = await connecting
        assert client.catalog.models
        await client.close()


def test_a_cut_that_has_not_come_is_told_again_first() -> None:
    wishes = Wishes()
    cut = session_pb2.Seek(start_pose=session_pb2.StartPose(x=5))
    wishes.take(session_pb2.SessionEvent(seek=cut), 70, 50)
    wishes.take(session_pb2.SessionEvent(set_velocity=session_pb2.SetVelocity(x=1, hold_frames=90)), 75, 50)
    told = wishes.events_from(65)
    assert [event.WhichOneof("event") for event in told] == ["seek", "set_velocity"]
    assert told[0].seek == cut
    assert [event.WhichOneof("event") for event in wishes.events_from(71)] == ["set_velocity"]


def test_a_frame_to_go_back_to_is_counted_from_the_new_beginning() -> None:
    moved = shifted(session_pb2.SessionEvent(seek=session_pb2.Seek(frame=50)), 40)
    assert moved is not None
    assert moved.seek.frame == 10
    assert shifted(session_pb2.SessionEvent(seek=session_pb2.Seek(frame=40)), 40) is None
    pose = session_pb2.SessionEvent(seek=session_pb2.Seek(start_pose=session_pb2.StartPose(x=1)))
    assert shifted(pose, 40) == pose


async def test_where_no_session_is_resumed_it_is_opened_anew_with_what_was_held(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("one", later_prompts={500: "two"})
    await session.set_prompt("three")
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0]
    assert opening.event_seq == 1
    assert opening.open.prior_frames.frame_count == 4
    frame = session.reopenings[0].frame
    assert frame >= 40
    assert [(each.text, each.start_frame) for each in opening.open.prompts] == [("three", 0), ("two", 500 - frame)]
    rest = [each.index async for each in session.frames(seconds=1, realtime=False)]
    assert rest == list(range(40, 140))
    edit = session.add_waypoint(1, 2, frame=frame + 100)
    assert (await edit).effective_frame is not None
    (sent,) = await received(server, "edit_constraints")
    assert sent.edit_constraints.upsert[0].frame == 100
    with pytest.raises(InvalidInput, match="frames still to come"):
        session.add_waypoint(1, 2, frame=frame - 10)


async def test_a_session_opened_anew_has_all_options_that_were_accepted(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("one", options=SessionOptions(text_guidance=2.0))
    server.refuse = lambda event: "NO_ROOM" if event.set_options.history_frames else ""
    edits = [
        session.set_options(denoise_steps=10, lookahead_frames=90),
        session.set_options(priority=Priority.HERO),
        session.set_options(guidance=(None, 3.0)),
    ]
    with pytest.raises(EventRefused, match="NO_ROOM"):
        await session.set_options(history_frames=8)
    assert all(edit.outcome for edit in edits)
    with pytest.raises(InvalidInput, match="denoise_steps"):
        session.set_options(denoise_steps=0)
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0].open
    assert (opening.denoise_steps, opening.lookahead_frames, opening.history_frames) == (10, 90, 0)
    assert opening.priority == session_pb2.PRIORITY_CLASS_HERO
    assert opening.guidance == session_pb2.Guidance(constraint=3.0)


async def test_a_session_that_nobody_looks_at_says_where_it_stands(client: MotionClient, server: FakeServer) -> None:
    await client.open("a person walks")
    reports = await received(server, "playhead", 2)
    assert {report.playhead.frame for report in reports} == {0}


async def test_a_paused_session_that_is_opened_anew_says_where_it_stands(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    async for _ in session.frames(seconds=0.2, realtime=False):
        pass
    await session.pause()
    server.stream.end()
    await until(lambda: session.reopenings or None)
    assert session.playback.playhead < session.reopenings[0].frame
    reports = await received(server, "playhead", 2)
    assert {report.playhead.frame for report in reports} == {0}, "it does not fall silent until it is resumed"
    await session.resume()
    assert session.is_reporting, "the server counts on from what it was told"


async def test_a_session_that_is_closed_ends_though_the_line_is_lost_before_the_answer(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("a person walks")
    monkeypatch.setattr(server.stream, "close", lambda handle: None)
    closing = asyncio.create_task(session.close())
    await received(server, "close")
    server.stream.end()
    end = await closing
    assert "the line was lost" in end.message
    assert await session.close() == end


async def test_a_session_opened_anew_goes_back_to_frames_of_before_by_the_frames_themselves(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = await client.open("a person walks")
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    monkeypatch.setattr(server.stream, "replan", lambda event: None)  # it has no answer when the line is lost
    waiting = session.seek(20)
    await received(server, "seek")
    server.stream.end()
    await until(lambda: session.reopenings or None)
    (again,) = await received(server, "seek")
    assert again.seek == convert.seek(None, session.motion(16, 20))
    assert (await waiting).effective_frame is not None
    await session.seek(12)
    assert (await received(server, "seek", 2))[-1].seek == convert.seek(None, session.motion(8, 12))
    frame = session.reopenings[0].frame
    await session.seek(frame + 5)
    assert (await received(server, "seek", 3))[-1].seek == session_pb2.Seek(frame=5)


async def test_what_was_met_already_is_not_asked_for_anew(client: MotionClient, server: FakeServer) -> None:
    session = await client.open("a person walks")
    edits = [session.add_waypoint(1, 2, frame=500, last_frame=9000), session.add_waypoint(3, 4, frame=9000)]
    met, open_still = [(await edit, edit.constraint_ids[0])[1] for edit in edits]
    news = session_pb2.ConstraintReached(constraint_id=met, met=True, frame=510)
    server.stream.push(session.handle, constraint_reached=news)
    await session.constraint_reached(met)
    server.stream.end()
    await until(lambda: session.reopenings or None)
    opening = server.stream.received[0].open
    assert [each.constraint_id for each in opening.constraints] == [open_still]


async def test_a_prompt_for_a_while_goes_by_itself_in_a_session_opened_anew_too(
    client: MotionClient, server: FakeServer
) -> None:
    session = await client.open("a person walks")
    await session.set_prompt("a person waves", frame=10, end_frame=1000)
    async for _ in session.frames(seconds=0.4, realtime=False):
        pass
    server.stream.end()
    await until(lambda: session.reopenings or None)
    assert [each.text for each in server.stream.received[0].open.prompts] == ["a person walks", "a person waves"]
    async for _ in session.frames(seconds=1, realtime=False):
        pass
    await session.set_prompt("a person runs")
    (sent,) = await received(server, "edit_prompts")
    assert not sent.edit_prompts.remove, "a server refuses an edit that removes what has ended"


async def test_what_a_session_opened_anew_was_opened_with_is_told_in_frames_of_the_application(
    client: MotionClient, server: FakeServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    push = FakeStream.push

    def with_placement(stream: FakeStream, handle: int, **update: object) -> None:
        opened = update.get("opened")
        if isinstance(opened, session_pb2.SessionOpened):
            opened.placements.add(constraint_id=1, first_frame=3, last_frame=9, arrival_frame=5, anchor_frame=2)
        push(stream, handle, **update)

    monkeypatch.setattr(FakeStream, "push", with_placement)
    session = await client.open("a person walks")
    (before,) = session.opened.placements
    server.stream.end()
    await until(lambda: session.reopenings or None)
    frame = session.reopenings[0].frame
    (after,) = session.opened.placements
    assert frame > 0
    assert (before.first_frame, session.opened.start_frame) == (3, frame)
    assert (after.first_frame, after.last_frame, after.arrival_frame, after.anchor_frame) == (
        frame + 3,
        frame + 9,
        frame + 5,
        frame + 2,
    )
