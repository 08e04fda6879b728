"""Constraint forms and prompts outside a model's training: refused, or accepted with a warning."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from motiongen.v1 import motion_pb2, session_pb2
from motiongen_compliance.messages import edit_constraints, edit_prompts, span, waypoint
from motiongen_server.engine.types import (
    Constraint,
    Guidance,
    JointTargets,
    Keyframe,
    Limb,
    RigLayout,
    RootTrajectory,
    SessionKey,
    SetVelocity,
    Warned,
    Waypoint,
)
from motiongen_server.errors import EventRefused
from motiongen_server.rpc.abilities import Abilities, FormSupport, PromptDomain
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert import engine_event, prompt_texts, warnings_of
from motiongen_server.rpc.convert.forms import forms_of
from motiongen_server.rpc.limits import Limits
from motiongen_server.text.presets import Preset
from tests.server.engine.fakes import FACTS

KEY = SessionKey(1, 1)
NAMES = ("Hips", "Spine", "Head", "RightArm", "RightHand", "LeftHand", "RightFoot", "LeftFoot", "LeftToe")
RIG = RigLayout(
    "body",
    NAMES,
    (-1, 0, 1, 1, 3, 1, 0, 0, 7),
    np.zeros((9, 3), np.float32),
    (),
    limbs=(
        Limb("LeftHand", (5,)),
        Limb("RightHand", (4, 3)),
        Limb("LeftFoot", (7, 8)),
        Limb("RightFoot", (6,)),
        Limb("Hips", (0,)),
    ),
)
DOMAIN = PromptDomain("length-1", np.zeros(2, np.float32), np.array([[1, 0]], np.float32), 0.5)


def _joints(*names: str, rotated: tuple[str, ...] = ()) -> JointTargets:
    joints = (0, *(NAMES.index(name) for name in names))
    rotations = np.zeros((len(joints), 3, 3), np.float32) if rotated else None
    which = tuple(NAMES[joint] in rotated for joint in joints) if rotated else None
    return JointTargets(1, 5, joints, np.zeros((len(joints), 3), np.float32), rotations, which)


@pytest.mark.parametrize(
    ("item", "forms"),
    [
        (Waypoint(1, 5, 0.0, 0.0, None), "waypoint"),
        (Waypoint(1, 5, 0.0, 0.0, 0.5), "waypoint waypoint_heading"),
        (RootTrajectory(1, 5, np.zeros((3, 2), np.float32), None), "trajectory"),
        (RootTrajectory(1, 5, np.zeros((3, 2), np.float32), np.zeros(3, np.float32)), "trajectory trajectory_heading"),
        (Keyframe(1, 5, np.zeros((9, 3), np.float32)), "keyframe"),
        (SetVelocity(KEY, 1, 0.0, 1.0, 0.0, None, 9), "velocity"),
        (SetVelocity(KEY, 1, 0.0, 1.0, 0.0, 0.0, 9), "velocity velocity_heading"),
        (_joints(), "root_height"),
        (_joints("LeftHand", "RightHand", "RightArm"), "hands"),
        (_joints("LeftToe"), "feet"),
        (_joints("LeftFoot", "Spine", "LeftHand"), "feet joints hands"),
        (_joints("RightHand", rotated=("RightHand",)), "hands"),
        (_joints("Head", rotated=("Head",)), "joints head_rotation"),
        (_joints("LeftHand", "Head", rotated=("LeftHand",)), "hands joints"),
        (_joints("RightHand", "RightArm", rotated=("RightArm",)), "hands joint_rotations"),
        (_joints("LeftHand", rotated=("Hips",)), "hands joint_rotations"),
    ],
)
def test_every_constraint_has_its_forms(item: Constraint | SetVelocity, forms: str) -> None:
    assert forms_of(item, RIG) == tuple(forms.split())


def _catalog(forms: Mapping[str, FormSupport] | None = None, domain: PromptDomain | None = None) -> Catalog:
    abilities = Abilities(forms or {}, known_motions=("walking", "waving"), domain=domain)
    presets = (Preset("far", "far away", np.array([0, 1], np.float32), "goes away"),)
    return Catalog(
        FACTS,
        Limits(),
        Guidance(2, 2),
        "CC0-1.0",
        text_encoder="length-1",
        history_frames=16,
        presets=presets,
        abilities=abilities,
    )


def _warned(event: session_pb2.SessionEvent, catalog: Catalog) -> tuple[Warned, ...]:
    """The warnings for an event. Texts that contain a blank are encoded as outside the domain."""
    texts = prompt_texts(event, catalog)
    embeddings = {text: np.array([0, 1] if " " in text else [1, 0], np.float32) for text in texts}
    return warnings_of(event, engine_event(event, KEY, 0.0, embeddings, catalog), catalog)


def _velocity(**fields: float) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(set_velocity=session_pb2.SetVelocity(x=1, hold_frames=9, **fields))  # type: ignore[arg-type]


def _opening(**fields: object) -> session_pb2.SessionEvent:
    return session_pb2.SessionEvent(event_seq=1, open=session_pb2.OpenSession(**fields))  # type: ignore[arg-type]


REFUSED = {"waypoint": FormSupport.TRAINED, "waypoint_heading": FormSupport.REFUSED, "velocity": FormSupport.REFUSED}


@pytest.mark.parametrize(
    ("event", "field"),
    [
        (edit_constraints(waypoint(9), waypoint(9, 2, heading=1.0)), "edit_constraints.upsert[1]"),
        (_opening(constraints=[waypoint(9, heading=1.0)]), "open.constraints[0]"),
        (_velocity(), "set_velocity"),
    ],
)
def test_unsupported_form_is_refused_with_its_field(event: session_pb2.SessionEvent, field: str) -> None:
    with pytest.raises(EventRefused) as caught:
        _warned(event, _catalog(REFUSED))
    assert (caught.value.reason, caught.value.field) == ("UNSUPPORTED_CONSTRAINT", field)
    assert caught.value.allowed == "the forms waypoint"


def test_untrained_form_is_warned_about_once() -> None:
    catalog = _catalog({"waypoint": FormSupport.TRAINED, "waypoint_heading": FormSupport.UNTRAINED})
    event = edit_constraints(waypoint(9), waypoint(9, 2, heading=1.0), waypoint(10, 3, heading=1.0))
    (warning,) = _warned(event, catalog)
    assert (warning.reason, warning.field) == ("UNTRAINED_CONSTRAINT", "edit_constraints.upsert[1]")
    assert "waypoint_heading" in warning.message
    assert _warned(edit_constraints(waypoint(9)), catalog) == ()


def test_without_claims_every_form_and_prompt_is_accepted_silently() -> None:
    for event in (edit_constraints(waypoint(9, heading=1.0)), _velocity(heading=0.0), edit_prompts(span("sit down"))):
        assert _warned(event, _catalog()) == ()


def test_prompt_outside_the_domain_is_warned_about() -> None:
    catalog = _catalog(domain=DOMAIN)
    (warning,) = _warned(edit_prompts(span("walk"), span("sits down", 2)), catalog)
    assert (warning.reason, warning.field) == ("PROMPT_OUTSIDE_DOMAIN", "edit_prompts.upsert[1].text")
    assert warning.message.startswith("fake knows walking, waving; 'sits down' is outside")
    (warning,) = _warned(_opening(prompts=[span("x " * 100)]), catalog)
    assert warning.field == "open.prompts[0].text"
    assert len(warning.message) < 200


def test_presets_and_embeddings_are_not_judged() -> None:
    embedding = motion_pb2.TextEmbedding(text_encoder="length-1", values=[0, 1])
    spans = [
        motion_pb2.PromptSpan(prompt_id=1, preset_id="far"),
        motion_pb2.PromptSpan(prompt_id=2, text="sits down", embedding=embedding),
    ]
    assert _warned(edit_prompts(*spans), _catalog(domain=DOMAIN)) == ()


def test_distance_depends_on_direction_only() -> None:
    assert DOMAIN.distance(np.array([7, 0], np.float32)) == pytest.approx(0.0)
    assert DOMAIN.distance(np.array([-1, 0], np.float32)) == pytest.approx(2.0)
    assert DOMAIN.distance(np.zeros(2, np.float32)) == pytest.approx(1.0)


def test_catalogue_lists_forms_known_motions_and_descriptions() -> None:
    (model,) = _catalog(REFUSED).response("").models
    assert {form.form: form.support for form in model.constraint_forms} == {
        "waypoint": 1,
        "waypoint_heading": 3,
        "velocity": 3,
    }
    assert list(model.known_motions) == ["walking", "waving"]
    assert model.presets[0].description == "goes away"
