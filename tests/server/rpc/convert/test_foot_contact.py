"""Foot contacts: the joint targets made of them, and when they count as met."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_ardy.checkpoint.checkpoint import load_checkpoint
from motiongen_server.engine.session.kinematics import Posed
from motiongen_server.engine.session.residuals import Residual, nearest_frame
from motiongen_server.engine.types import Guidance, JointTargets, RigLayout, SetConstraints
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event
from motiongen_server.rpc.convert.foot_contact import SOLE_M, foot_contact_of
from motiongen_server.rpc.limits import Limits
from motiongen_server.runner.facts import model_facts
from tests.conftest import ROOT
from tests.server.rpc.convert.conversion import KEY

TINY = ROOT / "tests" / "data" / "golden" / "tiny-core27" / "checkpoint"


@pytest.fixture(scope="module")
def rig() -> RigLayout:
    return model_facts(load_checkpoint(TINY), "tiny", 4).rig


def asked(rig: RigLayout, limb: str = "LeftFoot", **fields: float) -> JointTargets:
    message = motion_pb2.FootContact(limb=limb, **fields)
    return foot_contact_of(message, 7, 30, "upsert[0].foot_contact", rig)


def test_with_a_heading_the_toes_are_ahead_of_the_ankle(rig: RigLayout) -> None:
    target = asked(rig, x=1.0, z=2.0, heading=math.pi / 2)
    assert [rig.joint_names[joint] for joint in target.joints] == ["LeftFoot", "LeftToeBase"]
    ankle, toes = target.positions
    np.testing.assert_allclose(ankle[[0, 2]], [1.0, 2.0], atol=1e-6)
    assert toes[1] == pytest.approx(SOLE_M)
    assert ankle[1] > toes[1]
    np.testing.assert_allclose(toes[[0, 2]], [1.0 + 0.1606, 2.0], atol=1e-3)


def test_foot_contact_of_an_edit_arrives_as_targets_of_its_joints(rig: RigLayout) -> None:
    facts = model_facts(load_checkpoint(TINY), "tiny", 4)
    catalog = Catalog(facts, Limits(), Guidance(2.0, 2.0), "CC0-1.0", text_encoder="hashed-1", history_frames=16)
    contact = motion_pb2.FootContact(limb="LeftFoot", x=1.0, z=2.0, heading=0.5)
    edit = session_pb2.EditConstraints(
        upsert=[motion_pb2.Constraint(constraint_id=7, frame=30, weight=0.25, foot_contact=contact)]
    )
    event = engine_event(session_pb2.SessionEvent(event_seq=2, edit_constraints=edit), KEY, 1.0, {}, catalog)
    assert isinstance(event, SetConstraints)
    (target,), same = event.upsert, asked(rig, x=1.0, z=2.0, heading=0.5)
    assert isinstance(target, JointTargets)
    assert (target.constraint_id, target.frame, target.weight) == (7, 30, 0.25)
    assert (target.joints, target.contacts) == (same.joints, same.contacts)
    np.testing.assert_array_equal(target.positions, same.positions)


def test_without_a_heading_only_the_ankle_is_targeted(rig: RigLayout) -> None:
    target = asked(rig, "RightFoot", x=-1.0)
    assert [rig.joint_names[joint] for joint in target.joints] == ["RightFoot"]
    assert (target.frame, target.constraint_id, target.contacts) == (30, 7, (2, 3))


@pytest.mark.parametrize(("limb", "allowed"), [("LeftHand", "LeftFoot or RightFoot"), ("", "LeftFoot or RightFoot")])
def test_limb_that_is_not_a_foot_is_refused(rig: RigLayout, limb: str, allowed: str) -> None:
    with pytest.raises(EventRefused) as refused:
        asked(rig, limb)
    assert (refused.value.reason, refused.value.field) == ("UNKNOWN_LIMB", "upsert[0].foot_contact.limb")
    assert refused.value.allowed == allowed


def test_foot_contact_is_refused_for_a_rig_without_contacts(rig: RigLayout) -> None:
    with pytest.raises(EventRefused, match="no foot") as refused:
        asked(replace(rig, blocks=rig.blocks[:2]))
    assert "no feet" in refused.value.allowed


def test_contact_is_met_while_that_foot_is_in_place_and_on_the_ground(rig: RigLayout) -> None:
    rows = np.zeros((3, rig.row_width), np.float32)
    rows[:, 3:-4:4] = 1.0
    rows[:, 1] = 0.97  # neutral: the feet are below the hips
    ankle = np.sum([rig.neutral_offsets[joint] for joint in chain(rig, "LeftFoot")], axis=0)
    target = asked(rig, x=float(ankle[0]), z=float(ankle[2]))
    residual = Residual()
    residual.add(target, 30, Posed(rig, rows[:1]))
    assert residual.position_m is not None
    assert residual.position_m.worst < 0.02
    assert not residual.is_within(target.tolerance)
    rows[2, -4] = 1.0  # the left heel is on the ground
    assert nearest_frame(target, 30, Posed(rig, rows)).frame == 32
    found = nearest_frame(target, 30, Posed(rig, rows))
    assert found.residual.is_within(target.tolerance)
    rows[2, -4], rows[2, -2] = 0.0, 1.0  # the right one is instead
    assert not nearest_frame(target, 30, Posed(rig, rows)).residual.is_within(target.tolerance)


def chain(rig: RigLayout, name: str) -> list[int]:
    joint, found = rig.joint_names.index(name), []
    while joint > 0:
        found.append(joint)
        joint = rig.parents[joint]
    return found
