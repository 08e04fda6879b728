"""Opens with a mistake: refused as a whole, with the field and what is allowed; other sessions are unaffected."""

from __future__ import annotations

import pytest

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import addressed, span, waypoint
from motiongen_compliance.mistakes import INF, NAN, Mistake, Status, check, long_text, opening
from motiongen_compliance.target import Scene

REFUSED_OPENS = [
    Mistake("unknown rig", lambda c: opening(rig_id="smurf"), "UNKNOWN_RIG", "open.rig_id", "", Status.NOT_FOUND),
    Mistake("unknown model", lambda c: opening(model_id="x"), "UNKNOWN_MODEL", "open.model_id", "", Status.NOT_FOUND),
    Mistake(
        "request id too long", lambda c: opening(request_id="x" * 65), "REQUEST_ID_TOO_LONG", "open.request_id", "64"
    ),
    Mistake("invalid priority", lambda c: opening(priority=9), "INVALID_PRIORITY", "open.priority", "HERO"),
    Mistake(
        "invalid scalar type", lambda c: opening(scalar_type=9), "INVALID_SCALAR_TYPE", "open.scalar_type", "F32_LE"
    ),
    Mistake(
        "lookahead too short",
        lambda c: opening(lookahead_frames=1),
        "LOOKAHEAD_OUT_OF_RANGE",
        "open.lookahead_frames",
        " to ",
    ),
    Mistake(
        "lookahead too long",
        lambda c: opening(lookahead_frames=c.limits.max_lookahead_frames + 1),
        "LOOKAHEAD_OUT_OF_RANGE",
        "open.lookahead_frames",
        " to ",
    ),
    Mistake("0 steps", lambda c: opening(denoise_steps=0), "DENOISE_STEPS_OUT_OF_RANGE", "open.denoise_steps", " to "),
    Mistake(
        "too many steps",
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
        "too many prompts",
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
        "start out of range",
        lambda c: opening(start_pose=session_pb2.StartPose(x=2 * c.limits.max_coordinate_m)),
        "COORDINATE_OUT_OF_RANGE",
        "open.start_pose.x",
        "within",
    ),
]


@pytest.mark.parametrize("mistake", REFUSED_OPENS, ids=lambda mistake: mistake.name)
async def test_invalid_open_is_refused_and_its_handle_stays_free(scene: Scene, mistake: Mistake) -> None:
    talk = scene.talk
    await talk.send(addressed(mistake.make(talk.catalog), 9, 1))
    await talk.until(lambda: 9 in talk.sessions and talk.sessions[9].outcome(1))
    check(await talk.answer(9, 1), mistake)
    await scene.others_play_on()
    assert talk.sessions[9].opened is None
    await talk.open(9)
