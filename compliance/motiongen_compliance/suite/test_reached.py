"""ConstraintReached comes when the constraint's frame is committed, and again to a client that may have missed it."""

from __future__ import annotations

import pytest

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_compliance.messages import edit_constraints, waypoint
from motiongen_compliance.talk import LIMIT_S, Talk, rig_of
from motiongen_compliance.target import Target


async def play_past(talk: Talk, handle: int, frame: int) -> None:
    heard = talk.sessions[handle]
    while heard.committed_to <= frame:
        await talk.plays_on(handle)


async def test_constraint_is_reported_once_with_its_error(target: Target) -> None:
    talk = await target.talk()
    far = waypoint(30, 3, x=90.0, z=-90.0, heading=0.5)
    anywhere = waypoint(30, 4, x=90.0, z=-90.0)
    anywhere.tolerance_m = 1000.0
    heard = await talk.open(1, constraints=[far, anywhere])
    await play_past(talk, 1, 30)
    await talk.until(lambda: len(heard.reached) == 2)
    missed, met = sorted(heard.reached, key=lambda reached: reached.constraint_id)
    assert (missed.constraint_id, missed.met, missed.frame) == (3, False, 30)
    assert missed.position_error_m > 10
    assert 0 <= missed.rotation_error_rad <= 3.15
    assert (met.constraint_id, met.met, met.frame) == (4, True, 30)
    assert not met.HasField("rotation_error_rad")


async def test_resuming_client_is_told_again_what_it_may_have_missed(target: Target) -> None:
    first = await target.talk()
    heard = await first.open(1, constraints=[waypoint(30)])
    await play_past(first, 1, 30)
    await first.until(lambda: heard.reached)
    told = list(heard.reached)
    heard.reached.clear()  # as if it had not been received
    first.call.cancel()
    second = await target.talk()
    await second.resume(1, heard)
    await second.until(lambda: heard.reached)
    assert heard.reached == told


async def test_headings_and_rotations_have_no_position_error(target: Target) -> None:
    heading = motion_pb2.Constraint(constraint_id=1, frame=20, heading=motion_pb2.HeadingTarget(heading=3.0))
    turn = motion_pb2.JointRotations(joints=[0], rotations=[0.0, 1.0, 0.0, 0.0])
    turned = motion_pb2.Constraint(constraint_id=2, frame=21, joint_rotations=turn)
    talk = await target.talk()
    heard = await talk.open(1, constraints=[heading, turned])
    await play_past(talk, 1, 21)
    await talk.until(lambda: len(heard.reached) == 2)
    for reached in heard.reached:
        assert not reached.HasField("position_error_m")
        assert reached.met == (reached.rotation_error_rad <= target.catalog.models[0].default_tolerance_rad)


async def test_clip_reports_which_constraints_are_met(target: Target) -> None:
    near, far = waypoint(10, 1, x=90.0), waypoint(5, 2, x=90.0)
    near.tolerance_m = 1000.0
    opening = session_pb2.OpenSession(constraints=[near, far])
    request = service_pb2.GenerateClipRequest(open=opening, frame_count=20)
    parts = [part async for part in target.stub.GenerateClip(request, timeout=LIMIT_S)]
    residuals = parts[-1].summary.residuals
    assert [(residual.constraint_id, residual.met, residual.frame_count) for residual in residuals] == [
        (1, True, 1),
        (2, False, 1),
    ]


async def test_catalogue_states_the_default_tolerances(target: Target) -> None:
    model = target.catalog.models[0]
    assert model.default_tolerance_m > 0
    assert 0 < model.default_tolerance_rad < 3.15


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("tolerance_m", -0.1, "TOLERANCE_OUT_OF_RANGE"),
        ("tolerance_m", float("inf"), "NOT_FINITE"),
        ("tolerance_rad", 3.3, "TOLERANCE_OUT_OF_RANGE"),
        ("tolerance_rad", float("nan"), "NOT_FINITE"),
    ],
)
async def test_tolerance_out_of_range_is_refused(target: Target, field: str, value: float, reason: str) -> None:
    talk = await target.talk()
    await talk.open(1)
    constraint: motion_pb2.Constraint = waypoint(900)
    setattr(constraint, field, value)
    outcome = await talk.edit(1, edit_constraints(constraint))
    assert (outcome.reason, outcome.field) == (reason, f"edit_constraints.upsert[0].{field}")


async def test_foot_contact_is_reported_or_refused_by_name(target: Target) -> None:
    feet = [limb.name for limb in rig_of(target.catalog).limbs if limb.name in ("LeftFoot", "RightFoot")]
    standing = motion_pb2.FootContact(limb=feet[0] if feet else "LeftFoot", x=90.0, z=0.0)
    talk = await target.talk()
    heard = await talk.open(1)
    asked = motion_pb2.Constraint(constraint_id=1, frame=60, foot_contact=standing)
    outcome = await talk.edit(1, edit_constraints(asked))
    nowhere = motion_pb2.Constraint(constraint_id=2, frame=60, foot_contact=motion_pb2.FootContact(limb="Tail"))
    refused = await talk.edit(1, edit_constraints(nowhere))
    assert (refused.reason, refused.field) == ("UNKNOWN_LIMB", "edit_constraints.upsert[0].foot_contact.limb")
    if outcome.code != 0:
        assert outcome.reason in ("UNKNOWN_LIMB", "UNSUPPORTED_CONSTRAINT")
        return
    await play_past(talk, 1, 60)
    await talk.until(lambda: heard.reached)
    assert not heard.reached[0].met
    assert heard.reached[0].position_error_m > 10
