"""Edits with a mistake: the answer names the field and what is allowed, nothing changes, and others are unaffected."""

from __future__ import annotations

import pytest

from motiongen.v1 import motion_pb2
from motiongen_compliance.messages import edit_constraints, edit_prompts, play_state, span, waypoint
from motiongen_compliance.mistakes import INF, NAN, Catalog, Event, Mistake, Status, check, long_text
from motiongen_compliance.talk import rig_of
from motiongen_compliance.target import Scene


def target_of(**target: object) -> Event:
    return edit_constraints(motion_pb2.Constraint(constraint_id=1, frame=500, **target))  # type: ignore[arg-type]


def joints(indices: list[int], positions: list[float], rotations: list[float]) -> Event:
    return target_of(joint_targets=motion_pb2.JointTargets(joints=indices, positions=positions, rotations=rotations))


def turned(indices: list[int], rotations: list[float]) -> Event:
    return target_of(joint_rotations=motion_pb2.JointRotations(joints=indices, rotations=rotations))


def path(positions: list[float], headings: list[float]) -> Event:
    return target_of(root_trajectory=motion_pb2.RootTrajectory(positions=positions, headings=headings))


def pose(catalog: Catalog, number: float, missing: int = 0) -> Event:
    count = 3 * len(rig_of(catalog).joints) - missing
    return target_of(keyframe=motion_pb2.Keyframe(positions=[number] * count))


PROMPT, CONSTRAINT = "edit_prompts.upsert[0]", "edit_constraints.upsert[0]"
PATH = f"{CONSTRAINT}.root_trajectory"
JOINTS = f"{CONSTRAINT}.joint_targets"
TURNED = f"{CONSTRAINT}.joint_rotations"
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
        "prompt frame too large",
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
        "too many constraints",
        lambda c: edit_constraints(*(waypoint(500, i + 1) for i in range(c.limits.max_constraints + 1))),
        "TOO_MANY_CONSTRAINTS",
        "edit_constraints.upsert",
        "at most",
        Status.RESOURCE_EXHAUSTED,
    ),
    Mistake(
        "NaN heading target",
        lambda c: target_of(heading=motion_pb2.HeadingTarget(heading=NAN)),
        "NOT_FINITE",
        f"{CONSTRAINT}.heading.heading",
        "finite radians",
    ),
    Mistake("rotation of no joint", lambda c: turned([], []), "INVALID_JOINTS", f"{TURNED}.joints", "one or more"),
    Mistake(
        "rotation of a joint twice", lambda c: turned([0, 0], UNIT * 2), "INVALID_JOINTS", f"{TURNED}.joints", "once"
    ),
    Mistake("rotation too short", lambda c: turned([0], [1.0]), "WRONG_LENGTH", f"{TURNED}.rotations", "4 numbers"),
    Mistake(
        "rotation of length 0", lambda c: turned([0], [0.0] * 4), "NOT_A_ROTATION", f"{TURNED}.rotations", "1 within"
    ),
    Mistake(
        "infinite rotation", lambda c: turned([0], [INF] * 4), "NOT_FINITE", f"{TURNED}.rotations", "finite numbers"
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
        "infinite heading",
        lambda c: edit_constraints(waypoint(500, heading=-INF)),
        "NOT_FINITE",
        f"{CONSTRAINT}.waypoint.heading",
        "finite radians",
    ),
    Mistake(
        "x out of range",
        lambda c: edit_constraints(waypoint(500, x=2 * c.limits.max_coordinate_m)),
        "COORDINATE_OUT_OF_RANGE",
        f"{CONSTRAINT}.waypoint.x",
        "within",
    ),
    Mistake(
        "frame too large",
        lambda c: edit_constraints(waypoint(2**64 - 1)),
        "FRAME_OUT_OF_RANGE",
        f"{CONSTRAINT}.frame",
        "9007199254740992",
    ),
    Mistake("empty trajectory", lambda c: path([], []), "WRONG_LENGTH", f"{PATH}.positions", "2 numbers"),
    Mistake("odd number of coordinates", lambda c: path([1.0] * 3, []), "WRONG_LENGTH", f"{PATH}.positions", "2 num"),
    Mistake(
        "trajectory too long",
        lambda c: path([0.0] * (2 * c.limits.max_trajectory_frames + 2), []),
        "WRONG_LENGTH",
        f"{PATH}.positions",
        "frames",
    ),
    Mistake("NaN trajectory", lambda c: path([0, NAN], []), "NOT_FINITE", f"{PATH}.positions", "finite"),
    Mistake(
        "too few headings",
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
        "no target joint",
        lambda c: joints([], [], []),
        "INVALID_JOINTS",
        f"{JOINTS}.joints",
        "one or more",
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
        "too few positions",
        lambda c: joints([0], [0.0] * 2, []),
        "WRONG_LENGTH",
        f"{JOINTS}.positions",
        "3",
    ),
    Mistake(
        "infinite position",
        lambda c: joints([0], [INF, 0, 0], []),
        "NOT_FINITE",
        f"{JOINTS}.positions",
        "fin",
    ),
    Mistake(
        "too few rotations",
        lambda c: joints([0], [0.0] * 3, [1.0]),
        "WRONG_LENGTH",
        f"{JOINTS}.rotations",
        "4 numbers",
    ),
    Mistake(
        "not a rotation",
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
    Mistake(
        "keyframe too short",
        lambda c: pose(c, 0.0, 1),
        "WRONG_LENGTH",
        f"{CONSTRAINT}.keyframe.positions",
        "3 for each",
    ),
    Mistake("NaN keyframe", lambda c: pose(c, NAN), "NOT_FINITE", f"{CONSTRAINT}.keyframe.positions", "finite metres"),
    Mistake("no play state", lambda c: play_state(0), "INVALID_PLAY_STATE", "set_play_state.state", "PLAYING"),
    Mistake("unknown play state", lambda c: play_state(7), "INVALID_PLAY_STATE", "set_play_state.state", "PAUSED"),
]


@pytest.mark.parametrize("mistake", REFUSED_EDITS, ids=lambda mistake: mistake.name)
async def test_invalid_edit_is_refused_and_changes_nothing(scene: Scene, mistake: Mistake) -> None:
    talk = scene.talk
    check(await talk.edit(1, mistake.make(talk.catalog)), mistake)
    assert talk.sessions[1].applied_seq == 2, "its number is used up"
    assert (await talk.edit(1, edit_prompts(span("a person goes on")))).code == 0
    await talk.plays_on(1)
    await scene.others_play_on()
