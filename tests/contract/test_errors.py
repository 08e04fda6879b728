"""Bad input: each mistake gets a typed answer with field and allowed values, and leaves every other session alone."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import grpc
import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from tests.contract.conftest import Scene, Target
from tests.contract.talk import (
    PAUSE,
    RESUME,
    addressed,
    edit_constraints,
    edit_prompts,
    play_state,
    span,
    waypoint,
)

Event = session_pb2.SessionEvent
Catalog = service_pb2.GetCatalogResponse
Status = grpc.StatusCode
NAN, INF = math.nan, math.inf


@dataclass(frozen=True)
class Mistake:
    """An event, made for a server's catalogue, and the answer to it. allowed: words that the answer must contain."""

    name: str
    make: Callable[[Catalog], Event]
    reason: str
    field: str
    allowed: str
    code: Status = Status.INVALID_ARGUMENT


def opening(**fields: object) -> Event:
    return Event(open=session_pb2.OpenSession(**fields))  # type: ignore[arg-type]


def target_of(**target: object) -> Event:
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, frame=500, **target))  # type: ignore[arg-type]


def joints(indices: list[int], positions: list[float], rotations: list[float]) -> Event:
    return target_of(joint_targets=motion_pb2.JointTargets(joints=indices, positions=positions, rotations=rotations))


def path(positions: list[float], headings: list[float]) -> Event:
    return target_of(root_trajectory=motion_pb2.RootTrajectory(positions=positions, headings=headings))


def pose(catalog: Catalog, number: float, missing: int = 0) -> Event:
    count = 3 * len(catalog.rigs[0].joints) - missing
    return target_of(keyframe=motion_pb2.Keyframe(positions=[number] * count))


def long_text(catalog: Catalog) -> str:
    return "a" * max(10_000, catalog.limits.max_prompt_characters + 1)


REFUSED_OPENS = [
    Mistake("unknown rig", lambda c: opening(rig_id="smurf"), "UNKNOWN_RIG", "open.rig_id", "", Status.NOT_FOUND),
    Mistake("unknown model", lambda c: opening(model_id="x"), "UNKNOWN_MODEL", "open.model_id", "", Status.NOT_FOUND),
    Mistake("long id", lambda c: opening(request_id="x" * 65), "REQUEST_ID_TOO_LONG", "open.request_id", "64"),
    Mistake("priority", lambda c: opening(priority=9), "INVALID_PRIORITY", "open.priority", "HERO"),
    Mistake("scalar type", lambda c: opening(scalar_type=9), "INVALID_SCALAR_TYPE", "open.scalar_type", "F32_LE"),
    Mistake(
        "short lookahead",
        lambda c: opening(lookahead_frames=1),
        "LOOKAHEAD_OUT_OF_RANGE",
        "open.lookahead_frames",
        "40",
    ),
    Mistake(
        "long lookahead",
        lambda c: opening(lookahead_frames=c.limits.max_lookahead_frames + 1),
        "LOOKAHEAD_OUT_OF_RANGE",
        "open.lookahead_frames",
        " to ",
    ),
    Mistake("no steps", lambda c: opening(denoise_steps=0), "DENOISE_STEPS_OUT_OF_RANGE", "open.denoise_steps", " to "),
    Mistake(
        "many steps",
        lambda c: opening(denoise_steps=c.models[0].max_denoise_steps + 1),
        "DENOISE_STEPS_OUT_OF_RANGE",
        "open.denoise_steps",
        " to ",
    ),
    Mistake(
        "negative guidance",
        lambda c: opening(guidance=session_pb2.Guidance(text=-0.1)),
        "GUIDANCE_OUT_OF_RANGE",
        "open.guidance.text",
        "0 to",
    ),
    Mistake(
        "NaN guidance",
        lambda c: opening(guidance=session_pb2.Guidance(constraint=NAN)),
        "NOT_FINITE",
        "open.guidance.constraint",
        "0 to",
    ),
    Mistake("blank prompt", lambda c: opening(prompts=[span(" ")]), "EMPTY_PROMPT", "open.prompts[0].text", "1 to"),
    Mistake(
        "long prompt",
        lambda c: opening(prompts=[span(), span(long_text(c), 2)]),
        "PROMPT_TOO_LONG",
        "open.prompts[1].text",
        "characters",
    ),
    Mistake(
        "many prompts",
        lambda c: opening(prompts=[span(f"{i}", i + 1) for i in range(c.limits.max_prompts + 1)]),
        "TOO_MANY_PROMPTS",
        "open.prompts",
        "at most",
        Status.RESOURCE_EXHAUSTED,
    ),
    Mistake(
        "NaN waypoint",
        lambda c: opening(constraints=[waypoint(30, x=NAN)]),
        "NOT_FINITE",
        "open.constraints[0].waypoint.x",
        "finite metres",
    ),
    Mistake(
        "start at infinity",
        lambda c: opening(start_pose=session_pb2.StartPose(z=-INF)),
        "NOT_FINITE",
        "open.start_pose.z",
        "finite metres",
    ),
    Mistake(
        "NaN start heading",
        lambda c: opening(start_pose=session_pb2.StartPose(heading=NAN)),
        "NOT_FINITE",
        "open.start_pose.heading",
        "finite radians",
    ),
    Mistake(
        "start far off",
        lambda c: opening(start_pose=session_pb2.StartPose(x=2 * c.limits.max_coordinate_m)),
        "COORDINATE_OUT_OF_RANGE",
        "open.start_pose.x",
        "within",
    ),
]

PROMPT, CONSTRAINT = "edit_prompts.upsert[0]", "edit_constraints.upsert[0]"
PATH = f"{CONSTRAINT}.root_trajectory"
JOINTS = f"{CONSTRAINT}.joint_targets"
UNIT = [1.0, 0.0, 0.0, 0.0]

REFUSED_EDITS = [
    Mistake("empty prompt", lambda c: edit_prompts(span("")), "EMPTY_PROMPT", f"{PROMPT}.text", "not all blank"),
    Mistake("blank prompt", lambda c: edit_prompts(span("\t \n")), "EMPTY_PROMPT", f"{PROMPT}.text", "not all blank"),
    Mistake("long prompt", lambda c: edit_prompts(span(long_text(c))), "PROMPT_TOO_LONG", f"{PROMPT}.text", "1 to"),
    Mistake(
        "empty span", lambda c: edit_prompts(span(start=90, end=90)), "EMPTY_SPAN", f"{PROMPT}.end_frame", "above 90"
    ),
    Mistake("prompt id 0", lambda c: edit_prompts(span(prompt_id=0)), "INVALID_ID", f"{PROMPT}.prompt_id", "1 or more"),
    Mistake(
        "far prompt",
        lambda c: edit_prompts(span(start=2**53 + 1)),
        "FRAME_OUT_OF_RANGE",
        f"{PROMPT}.start_frame",
        "9007199254740992",
    ),
    Mistake(
        "unknown prompt",
        lambda c: edit_prompts(remove=[99]),
        "UNKNOWN_PROMPT",
        "edit_prompts.remove[0]",
        "ids that are set",
        Status.NOT_FOUND,
    ),
    Mistake(
        "unknown constraint",
        lambda c: edit_constraints(remove=[99]),
        "UNKNOWN_CONSTRAINT",
        "edit_constraints.remove[0]",
        "ids that are set",
        Status.NOT_FOUND,
    ),
    Mistake(
        "constraint id 0",
        lambda c: edit_constraints(waypoint(500, 0)),
        "INVALID_ID",
        f"{CONSTRAINT}.constraint_id",
        "1 or more",
    ),
    Mistake(
        "many constraints",
        lambda c: edit_constraints(*(waypoint(500, i + 1) for i in range(c.limits.max_constraints + 1))),
        "TOO_MANY_CONSTRAINTS",
        "edit_constraints.upsert",
        "at most",
        Status.RESOURCE_EXHAUSTED,
    ),
    Mistake("no target", lambda c: target_of(), "NO_TARGET", f"{CONSTRAINT}.target", "waypoint, joint_targets"),
    Mistake(
        "NaN x",
        lambda c: edit_constraints(waypoint(500, x=NAN)),
        "NOT_FINITE",
        f"{CONSTRAINT}.waypoint.x",
        "finite metres",
    ),
    Mistake(
        "infinite z",
        lambda c: edit_constraints(waypoint(500, z=INF)),
        "NOT_FINITE",
        f"{CONSTRAINT}.waypoint.z",
        "finite metres",
    ),
    Mistake(
        "minus infinite heading",
        lambda c: edit_constraints(waypoint(500, heading=-INF)),
        "NOT_FINITE",
        f"{CONSTRAINT}.waypoint.heading",
        "finite radians",
    ),
    Mistake(
        "far x",
        lambda c: edit_constraints(waypoint(500, x=2 * c.limits.max_coordinate_m)),
        "COORDINATE_OUT_OF_RANGE",
        f"{CONSTRAINT}.waypoint.x",
        "within",
    ),
    Mistake(
        "far frame",
        lambda c: edit_constraints(waypoint(2**64 - 1)),
        "FRAME_OUT_OF_RANGE",
        f"{CONSTRAINT}.frame",
        "9007199254740992",
    ),
    Mistake("empty path", lambda c: path([], []), "WRONG_LENGTH", f"{PATH}.positions", "2 numbers"),
    Mistake("odd path", lambda c: path([1.0] * 3, []), "WRONG_LENGTH", f"{PATH}.positions", "2 num"),
    Mistake(
        "long path",
        lambda c: path([0.0] * (2 * c.limits.max_trajectory_frames + 2), []),
        "WRONG_LENGTH",
        f"{PATH}.positions",
        "frames",
    ),
    Mistake("NaN path", lambda c: path([0, NAN], []), "NOT_FINITE", f"{PATH}.positions", "finite"),
    Mistake(
        "few headings",
        lambda c: path([0.0] * 4, [0.0]),
        "WRONG_LENGTH",
        f"{PATH}.headings",
        "one heading a frame",
    ),
    Mistake(
        "NaN headings",
        lambda c: path([0.0] * 4, [0.0, NAN]),
        "NOT_FINITE",
        f"{PATH}.headings",
        "finite radians",
    ),
    Mistake(
        "no root joint",
        lambda c: joints([], [], []),
        "ROOT_JOINT_MISSING",
        f"{JOINTS}.joints",
        "0 and",
    ),
    Mistake(
        "joint beyond the rig",
        lambda c: joints([0, 10_000], [0.0] * 6, []),
        "INVALID_JOINTS",
        f"{JOINTS}.joints",
        "at most once",
    ),
    Mistake(
        "joint twice",
        lambda c: joints([0, 0], [0.0] * 6, []),
        "INVALID_JOINTS",
        f"{JOINTS}.joints",
        "once",
    ),
    Mistake(
        "few positions",
        lambda c: joints([0], [0.0] * 2, []),
        "WRONG_LENGTH",
        f"{JOINTS}.positions",
        "3",
    ),
    Mistake(
        "infinite joint",
        lambda c: joints([0], [INF, 0, 0], []),
        "NOT_FINITE",
        f"{JOINTS}.positions",
        "fin",
    ),
    Mistake(
        "few rotations",
        lambda c: joints([0], [0.0] * 3, [1.0]),
        "WRONG_LENGTH",
        f"{JOINTS}.rotations",
        "4 numbers",
    ),
    Mistake(
        "no rotation",
        lambda c: joints([0], [0.0] * 3, [2.0, 0.0, 0.0, 0.0]),
        "NOT_A_ROTATION",
        f"{JOINTS}.rotations",
        "1 within 0.001",
    ),
    Mistake(
        "NaN rotation",
        lambda c: joints([0], [0.0] * 3, [NAN, 0.0, 0.0, 0.0]),
        "NOT_FINITE",
        f"{JOINTS}.rotations",
        "finite",
    ),
    Mistake("short pose", lambda c: pose(c, 0.0, 1), "WRONG_LENGTH", f"{CONSTRAINT}.keyframe.positions", "3 for each"),
    Mistake("NaN pose", lambda c: pose(c, NAN), "NOT_FINITE", f"{CONSTRAINT}.keyframe.positions", "finite metres"),
    Mistake("no state", lambda c: play_state(0), "INVALID_PLAY_STATE", "set_play_state.state", "PLAYING"),
    Mistake("odd state", lambda c: play_state(7), "INVALID_PLAY_STATE", "set_play_state.state", "PAUSED"),
]


def check(outcome: session_pb2.EditOutcome, mistake: Mistake) -> None:
    told = (outcome.code, outcome.reason, outcome.field)
    assert told == (mistake.code.value[0], mistake.reason, mistake.field), outcome.message
    assert mistake.allowed in outcome.allowed
    assert outcome.allowed
    assert len(outcome.message) < 500, "a mistake is not sent back whole"


@pytest.mark.parametrize("mistake", REFUSED_OPENS, ids=lambda mistake: mistake.name)
async def test_a_wrong_open_is_refused_whole(scene: Scene, mistake: Mistake) -> None:
    talk = scene.talk
    await talk.send(addressed(mistake.make(talk.catalog), 9, 1))
    await talk.until(lambda: 9 in talk.sessions and talk.sessions[9].outcome(1))
    check(await talk.answer(9, 1), mistake)
    await scene.others_play_on()
    assert talk.sessions[9].opened is None
    await talk.open(9)


@pytest.mark.parametrize("mistake", REFUSED_EDITS, ids=lambda mistake: mistake.name)
async def test_a_wrong_edit_changes_nothing(scene: Scene, mistake: Mistake) -> None:
    talk = scene.talk
    check(await talk.edit(1, mistake.make(talk.catalog)), mistake)
    assert talk.sessions[1].applied_seq == 2, "its number is used up"
    assert (await talk.edit(1, edit_prompts(span("a person goes on")))).code == 0
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_unknown_names_are_answered_with_those_there_are(target: Target) -> None:
    talk = await target.talk()
    await talk.ask_open(1, rig_id="smurf")
    assert talk.catalog.rigs[0].rig_id in (await talk.answer(1, 1)).allowed
    await talk.ask_open(2, model_id="none")
    assert talk.catalog.models[0].model_id in (await talk.answer(2, 1)).allowed


async def test_committed_frames_are_refused_and_the_first_free_one_is_named(scene: Scene) -> None:
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
async def test_an_event_for_a_handle_that_is_not_open(scene: Scene, event: Event) -> None:
    talk = scene.talk
    await talk.send(addressed(event, 33, 1))
    await talk.until(lambda: 33 in talk.sessions)
    mistake = Mistake("", lambda c: event, "SESSION_NOT_OPEN", "session", "OpenSession", Status.NOT_FOUND)
    check(await talk.answer(33, 1), mistake)
    await scene.others_play_on()


async def test_a_handle_in_use_is_refused_and_its_session_lives(scene: Scene) -> None:
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
async def test_a_number_where_none_belongs(scene: Scene, event: Event, number: int) -> None:
    talk = scene.talk
    await talk.send(addressed(event, 1, number))
    check(
        await talk.answer(1, number), Mistake("", lambda c: event, "INVALID_EVENT_SEQ", "event_seq", "0 for Playhead")
    )
    assert (await talk.edit(1, PAUSE)).code == 0, "the next number is still free"
    await scene.others_play_on()


async def test_a_playhead_out_of_range_is_refused(scene: Scene) -> None:
    talk = scene.talk
    await talk.send(Event(session=1, playhead=session_pb2.Playhead(frame=2**60)))
    mistake = Mistake("", lambda c: Event(), "FRAME_OUT_OF_RANGE", "playhead.frame", "9007199254740992")
    check(await talk.answer(1, 0), mistake)
    await talk.plays_on(1)
    await scene.others_play_on()


async def test_events_that_come_too_fast_are_refused_one_by_one(scene: Scene) -> None:
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


async def test_a_message_of_10_mb_ends_its_stream_alone(scene: Scene) -> None:
    other = scene.other
    await scene.talk.send(addressed(edit_prompts(span("x" * 10_000_000)), 1, 2))
    assert await scene.talk.to_the_end() is Status.RESOURCE_EXHAUSTED
    await other.plays_on(1)
    await other.open(2)
