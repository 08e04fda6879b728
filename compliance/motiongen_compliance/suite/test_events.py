"""Events and their answers: numbers, order of effect, repetitions, and messages about the stream itself."""

from __future__ import annotations

import grpc

from motiongen.v1 import service_pb2, session_pb2
from motiongen_compliance.messages import (
    PAUSE,
    RESUME,
    addressed,
    close,
    edit_constraints,
    edit_prompts,
    span,
    waypoint,
)
from motiongen_compliance.target import Scene, Target

OK = grpc.StatusCode.OK.value[0]
FAILED_PRECONDITION = grpc.StatusCode.FAILED_PRECONDITION.value[0]
UNIMPLEMENTED = grpc.StatusCode.UNIMPLEMENTED.value[0]


async def test_every_numbered_event_is_answered_once_and_accepted(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    events = [
        edit_prompts(span("jump")),
        PAUSE,
        edit_constraints(waypoint(300, x=1.0)),
        RESUME,
        edit_prompts(span("turn", 2, start=400), remove=[1]),
        edit_constraints(remove=[1]),
    ]
    await talk.send(*(addressed(event, 1, number) for number, event in enumerate(events, start=2)))
    last = len(events) + 1
    await talk.until(lambda: all(heard.outcome(number) for number in range(2, last + 1)))
    assert [heard.outcome(number).code for number in range(2, last + 1)] == [OK] * len(events)  # type: ignore[union-attr]
    assert heard.applied_seq == last
    await scene.others_play_on()


async def test_applied_seq_counts_no_event_before_it_and_all_earlier_ones_are_answered(target: Target) -> None:
    """`Heard` compares it with the answers in every update. A SetPlayState is answered before an earlier edit."""
    talk = await target.talk()
    heard = await talk.open(1)
    events = [edit_prompts(span("jump")), PAUSE, edit_constraints(waypoint(300, x=1.0)), RESUME, edit_prompts(span())]
    last = len(events) + 1
    await talk.send(*(addressed(event, 1, number) for number, event in enumerate(events, start=2)))
    await talk.until(lambda: heard.applied_seq == last)
    assert heard.answered == set(range(1, last + 1))


async def test_events_of_one_message_take_effect_in_the_order_of_their_numbers(scene: Scene) -> None:
    """In any other order, another of them would name an id that is not set, or the session would stay paused."""
    talk = scene.talk
    unknown = span("a text that nobody has asked for yet", 5, start=400)  # events after it wait while it is encoded
    events = [
        PAUSE,
        edit_prompts(unknown),
        edit_prompts(remove=[5]),
        edit_prompts(remove=[5]),
        edit_constraints(waypoint(300, 5, x=1.0)),
        edit_constraints(remove=[5]),
        edit_constraints(remove=[5]),
        RESUME,
    ]
    await talk.send(*(addressed(event, 1, number) for number, event in enumerate(events, start=2)))
    answers = [await talk.answer(1, number) for number in range(2, len(events) + 2)]
    refused = {3: "UNKNOWN_PROMPT", 6: "UNKNOWN_CONSTRAINT"}
    assert [answer.reason for answer in answers] == [refused.get(number, "") for number in range(len(events))]
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_repeated_event_is_dropped_and_a_gap_in_numbers_refused(scene: Scene) -> None:
    talk = scene.talk
    await talk.edit(1, PAUSE)
    await talk.send(addressed(PAUSE, 1, 2), addressed(RESUME, 1, 4))
    gap = await talk.answer(1, 4)
    assert (gap.code, gap.reason, gap.field) == (FAILED_PRECONDITION, "SEQUENCE_GAP", "event_seq")
    assert "3" in gap.allowed
    assert (await talk.edit(1, RESUME)).code == OK, "the right number is accepted afterwards"
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_unknown_event_is_refused_as_unimplemented(scene: Scene) -> None:
    talk = scene.talk
    member_1000 = b"\xc2\x3e\x00"
    outcome = await talk.edit(1, session_pb2.SessionEvent.FromString(member_1000))
    assert (outcome.code, outcome.reason, outcome.field) == (UNIMPLEMENTED, "UNKNOWN_EVENT", "event")
    assert outcome.allowed
    assert (await talk.edit(1, PAUSE)).code == OK
    await talk.edit(1, RESUME)
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_edit_that_changes_no_frame_has_no_effective_frame(target: Target) -> None:
    talk = await target.talk()
    await talk.open(1, prompts=[span("walk")])
    outcome = await talk.edit(1, edit_constraints())
    assert (outcome.code, outcome.HasField("effective_frame")) == (OK, False)


async def test_edit_of_the_far_future_is_answered_at_once(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    outcome = await talk.edit(1, edit_constraints(waypoint(5000, x=3.0, z=4.0)))
    assert outcome.code == OK
    assert heard.end < 5000


async def test_playhead_of_an_unknown_session_is_dropped(scene: Scene) -> None:
    talk = scene.talk
    await talk.send(session_pb2.SessionEvent(session=77, playhead=session_pb2.Playhead(frame=3)))
    await talk.ping(2)
    assert 77 not in talk.sessions
    await scene.others_play_on()


async def test_ping_is_answered_with_its_number(target: Target) -> None:
    talk = await target.talk()
    for number in (-1, 0, 2**62):
        pong = await talk.ping(number)
        assert pong.client_time_ns == number
        assert pong.server_time_ns > 0


async def test_ping_and_events_may_share_a_message(target: Target) -> None:
    talk = await target.talk()
    opening = session_pb2.SessionEvent(session=1, event_seq=1, open=session_pb2.OpenSession())
    await talk.say(service_pb2.StreamMotionRequest(ping=service_pb2.Ping(client_time_ns=5), events=[opening]))
    await talk.until(lambda: 1 in talk.sessions and talk.sessions[1].chunks)
    assert [response.pong.client_time_ns for response in talk.responses if response.HasField("pong")] == [5]


async def test_events_after_a_close_are_refused_before_session_closed(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    await talk.send(addressed(close(), 1, 2), addressed(PAUSE, 1, 3))
    await talk.until(lambda: heard.closed is not None)
    refused = heard.outcome(3)
    assert refused is not None
    assert (refused.code, refused.reason) == (grpc.StatusCode.CANCELLED.value[0], "SESSION_CLOSED")
    await scene.others_play_on()


async def test_events_after_a_refused_open_are_refused_and_its_handle_stays_free(scene: Scene) -> None:
    talk = scene.talk
    refused = session_pb2.SessionEvent(session=9, event_seq=1, open=session_pb2.OpenSession(model_id="none"))
    heard = await talk.ask_open(9, model_id="none")
    await talk.send(addressed(PAUSE, 9, 2), addressed(RESUME, 9, 3))
    assert (await talk.answer(9, 1)).reason == "UNKNOWN_MODEL"
    for number in (2, 3):
        assert (await talk.answer(9, number)).reason in {"SESSION_NOT_OPEN", "SESSION_CLOSED"}
    heard.outcomes.clear()
    await talk.send(refused)
    assert (await talk.answer(9, 1)).reason == "UNKNOWN_MODEL", "number 1 is free again"
    await talk.open(9)
    assert (await talk.edit(9, PAUSE)).code == OK
    await scene.others_play_on()


async def test_playheads_that_come_too_fast_are_refused_with_number_0(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    report = session_pb2.SessionEvent(session=1, playhead=session_pb2.Playhead(frame=1))
    await talk.send(*[report] * (2 * round(talk.catalog.limits.max_events_per_second) + 20))
    await talk.until(lambda: heard.outcomes)
    refused = heard.outcomes[0]
    assert (refused.event_seq, refused.reason) == (0, "TOO_MANY_EVENTS")
    assert refused.retry_after.ToMilliseconds() >= 0
    await scene.others_play_on()


async def test_paused_session_is_edited_like_a_playing_one(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    assert (await talk.edit(1, PAUSE)).code == OK
    assert heard.opened is not None
    lookahead = heard.opened.lookahead_frames
    await talk.until(lambda: heard.end == lookahead)
    outcome = await talk.edit(1, edit_prompts(span("another")))
    assert outcome.HasField("effective_frame"), "frames that were sent already are replaced"
    await talk.until(lambda: heard.next_frame == lookahead)
    assert heard.end == lookahead
    await scene.others_play_on()
