"""Mistakes other than a wrong field of an event: unknown names, frames, handles, rates and sizes."""

from __future__ import annotations

import pytest

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import PAUSE, RESUME, addressed, edit_constraints, edit_prompts, span, waypoint
from motiongen_compliance.mistakes import Event, Mistake, Status, check, opening
from motiongen_compliance.talk import rig_of
from motiongen_compliance.target import Scene, Target

PROMPT, CONSTRAINT = "edit_prompts.upsert[0]", "edit_constraints.upsert[0]"


async def test_unknown_names_are_refused_with_the_known_ones(target: Target) -> None:
    talk = await target.talk()
    await talk.ask_open(1, rig_id="smurf")
    assert rig_of(talk.catalog).rig_id in (await talk.answer(1, 1)).allowed
    await talk.ask_open(2, model_id="none")
    assert talk.catalog.models[0].model_id in (await talk.answer(2, 1)).allowed


async def test_edit_of_committed_frames_is_refused_with_the_first_free_frame(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    while not heard.committed_to:
        await talk.plays_on(1)
    past = Mistake(
        "past", lambda c: Event(), "FRAME_COMMITTED", f"{CONSTRAINT}.frame", "a frame from ", Status.FAILED_PRECONDITION
    )
    outcome = await talk.edit(1, edit_constraints(waypoint(0, x=1.0)))
    check(outcome, past)
    first = int(outcome.allowed.split()[3])
    assert first >= heard.committed_to
    ended = Mistake("past", past.make, past.reason, f"{PROMPT}.end_frame", "a frame from ", past.code)
    check(await talk.edit(1, edit_prompts(span(start=0, end=1))), ended)
    assert (await talk.edit(1, edit_constraints(waypoint(first + 40, x=1.0)))).code == 0
    await talk.plays_on(1)
    await scene.others_play_on()


@pytest.mark.parametrize("event", [PAUSE, edit_prompts(span()), edit_constraints()], ids=["state", "prompt", "target"])
async def test_event_for_a_handle_that_is_not_open_is_refused(scene: Scene, event: Event) -> None:
    talk = scene.talk
    await talk.send(addressed(event, 33, 1))
    await talk.until(lambda: 33 in talk.sessions)
    mistake = Mistake("", lambda c: event, "SESSION_NOT_OPEN", "session", "OpenSession", Status.NOT_FOUND)
    check(await talk.answer(33, 1), mistake)
    await scene.others_play_on()


async def test_open_on_a_handle_in_use_is_refused_and_its_session_unharmed(scene: Scene) -> None:
    talk = scene.talk
    await talk.send(addressed(opening(), 1, 1))
    mistake = Mistake("", lambda c: opening(), "HANDLE_IN_USE", "session", "SessionClosed", Status.ALREADY_EXISTS)
    check(await talk.answer(1, 1), mistake)
    assert (await talk.edit(1, PAUSE)).code == 0
    await talk.edit(1, RESUME)
    await talk.plays_on(1)
    await scene.others_play_on()


@pytest.mark.parametrize(
    ("event", "number"), [(Event(playhead=session_pb2.Playhead()), 5), (PAUSE, 0)], ids=["report", "edit"]
)
async def test_event_number_that_is_not_allowed_is_refused(scene: Scene, event: Event, number: int) -> None:
    talk = scene.talk
    await talk.send(addressed(event, 1, number))
    check(
        await talk.answer(1, number), Mistake("", lambda c: event, "INVALID_EVENT_SEQ", "event_seq", "0 for Playhead")
    )
    assert (await talk.edit(1, PAUSE)).code == 0, "the next number is still free"
    await scene.others_play_on()


async def test_playhead_out_of_range_is_refused(scene: Scene) -> None:
    talk = scene.talk
    await talk.send(Event(session=1, playhead=session_pb2.Playhead(frame=2**60)))
    mistake = Mistake("", lambda c: Event(), "FRAME_OUT_OF_RANGE", "playhead.frame", "9007199254740992")
    check(await talk.answer(1, 0), mistake)
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_events_that_come_too_fast_are_each_answered_and_some_refused(scene: Scene) -> None:
    talk = scene.talk
    heard = talk.sessions[1]
    last = 2 * round(talk.catalog.limits.max_events_per_second) + 20
    await talk.send(*(addressed(PAUSE, 1, number) for number in range(2, last + 1)))
    await talk.until(lambda: len(heard.outcomes) == last - 1)
    assert [outcome.event_seq for outcome in sorted(heard.outcomes, key=lambda one: one.event_seq)] == list(
        range(2, last + 1)
    )
    refused = [outcome for outcome in heard.outcomes if outcome.reason == "TOO_MANY_EVENTS"]
    assert refused
    mistake = Mistake("", lambda c: PAUSE, "TOO_MANY_EVENTS", "event", "a second", Status.RESOURCE_EXHAUSTED)
    check(refused[0], mistake)
    await talk.until(lambda: heard.applied_seq == last)
    await scene.others_play_on()
