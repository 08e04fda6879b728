"""Options that change while a session is open."""

from __future__ import annotations

from motiongen.v1 import session_pb2
from motiongen_compliance.messages import edit_constraints, waypoint
from motiongen_compliance.target import Target


def options(**fields: int) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(set_options=session_pb2.SetOptions(**fields))  # type: ignore[arg-type]


async def test_options_change_without_an_effective_frame_and_the_session_goes_on(target: Target) -> None:
    model = target.catalog.models[0]
    talk = await target.talk()
    await talk.open(1)
    outcome = await talk.edit(1, options(denoise_steps=model.min_denoise_steps, priority=3))
    assert outcome.code == 0
    assert not outcome.HasField("effective_frame")
    await talk.plays_on(1)


async def test_longer_lookahead_brings_more_frames_and_a_shorter_one_keeps_them(target: Target) -> None:
    limits, talk = target.catalog.limits, await target.talk()
    least = target.catalog.models[0].horizon_frames
    heard = await talk.open(1, lookahead_frames=least)
    await talk.until(lambda: heard.end == least)
    assert (await talk.edit(1, options(lookahead_frames=limits.max_lookahead_frames))).code == 0
    await talk.until(lambda: heard.end == limits.max_lookahead_frames)
    plans = len(heard.plans)
    assert (await talk.edit(1, options(lookahead_frames=least))).code == 0
    await talk.ping(1)
    assert (heard.end, len(heard.plans)) == (limits.max_lookahead_frames, plans)
    await talk.plays_on(1)


async def test_option_out_of_range_is_refused_and_the_next_event_accepted(target: Target) -> None:
    model = target.catalog.models[0]
    talk = await target.talk()
    await talk.open(1)
    outcome = await talk.edit(1, options(denoise_steps=model.max_denoise_steps + 1))
    assert (outcome.reason, outcome.field) == ("DENOISE_STEPS_OUT_OF_RANGE", "set_options.denoise_steps")
    assert (await talk.edit(1, edit_constraints(waypoint(900)))).code == 0


async def test_placement_of_a_constraint_is_reported(target: Target) -> None:
    talk = await target.talk()
    await talk.open(1)
    there = waypoint(0, 5, x=0.5)
    there.at_any_frame = there.relative_to_character = True
    outcome = await talk.edit(1, edit_constraints(there))
    (placement,) = outcome.placements
    assert placement.constraint_id == 5
    assert placement.anchor_frame <= placement.first_frame <= placement.arrival_frame <= placement.last_frame
    heard = talk.sessions[1]
    while not heard.reached:
        await talk.plays_on(1)
    assert placement.first_frame <= heard.reached[0].frame <= placement.last_frame


async def test_seek_makes_a_cut_and_the_session_goes_on(target: Target) -> None:
    talk = await target.talk()
    await talk.open(1)
    pose = session_pb2.StartPose(x=3.0, z=-2.0, heading=1.0)
    outcome = await talk.edit(1, session_pb2.SessionEvent(seek=session_pb2.Seek(start_pose=pose)))
    assert outcome.code == 0
    assert outcome.HasField("effective_frame")
    await talk.plays_on(1)
    refused = await talk.edit(1, session_pb2.SessionEvent(seek=session_pb2.Seek()))
    assert (refused.reason, refused.field) == ("AMBIGUOUS_START", "seek")


async def test_seek_continues_from_an_earlier_frame_of_the_session(target: Target) -> None:
    talk = await target.talk()
    heard = await talk.open(1)
    while heard.end < target.catalog.models[0].patch_frames + 1:
        await talk.plays_on(1)
    frame = heard.end
    outcome = await talk.edit(1, session_pb2.SessionEvent(seek=session_pb2.Seek(frame=frame)))
    assert outcome.code == 0, outcome
    notice = next(plan for plan in heard.plans if heard.sent_seq in plan.event_seqs)
    assert notice.cause == session_pb2.PLAN_CAUSE_CUT
    assert notice.valid_from == outcome.effective_frame
    await talk.plays_on(1)


async def test_seek_to_a_frame_that_is_not_held_is_refused(target: Target) -> None:
    talk = await target.talk()
    await talk.open(1)
    ahead = await talk.edit(1, session_pb2.SessionEvent(seek=session_pb2.Seek(frame=2**40)))
    assert (ahead.code, ahead.reason, ahead.field) == (9, "FRAME_NOT_HELD", "seek.frame")
    assert ahead.allowed
    both = session_pb2.Seek(frame=8, start_pose=session_pb2.StartPose(x=1.0))
    refused = await talk.edit(1, session_pb2.SessionEvent(seek=both))
    assert (refused.reason, refused.field) == ("AMBIGUOUS_START", "seek.frame")
    await talk.plays_on(1)
