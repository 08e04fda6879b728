"""Forms of constraints: which forms a constraint has, and which of them the model was trained for or refuses."""

from __future__ import annotations

from collections.abc import Iterable

from motiongen_server.engine.types import (
    Asked,
    HeadingTarget,
    JointRotations,
    JointTargets,
    Keyframe,
    RigLayout,
    RootPath,
    RootTrajectory,
    SetVelocity,
    Unplaced,
    Waypoint,
)
from motiongen_server.rpc.abilities import FormSupport
from motiongen_server.rpc.catalog import Catalog
from motiongen_server.rpc.convert.checks import refuse

HEAD = "Head"
_LIMB_FORMS = {"LeftHand": "hands", "RightHand": "hands", "LeftFoot": "feet", "RightFoot": "feet"}


def forms_of(item: Asked | RootPath | SetVelocity, rig: RigLayout) -> tuple[str, ...]:
    """The forms of a constraint or a velocity, by their names in ConstraintForm."""
    match item:
        case Waypoint():
            return ("waypoint",) if item.heading is None else ("waypoint", "waypoint_heading")
        case Unplaced():
            return forms_of(item.target, rig)
        case RootPath():
            return ("trajectory",)
        case RootTrajectory():
            return ("trajectory",) if item.heading is None else ("trajectory", "trajectory_heading")
        case SetVelocity():
            return ("velocity",) if item.heading is None else ("velocity", "velocity_heading")
        case Keyframe():
            return ("keyframe",)
        case HeadingTarget():
            return ("waypoint_heading",)
        case JointRotations():
            return tuple(dict.fromkeys(_rotation_form(joint, rig) for joint in item.joints))
        case JointTargets():
            return _joint_forms(item, rig)


def check_forms(item: Asked | RootPath | SetVelocity, field: str, catalog: Catalog) -> None:
    """Raise EventRefused if the model refuses one of the forms."""
    support = catalog.abilities.forms
    if not support:
        return
    for form in forms_of(item, catalog.facts.rig):
        if support.get(form) is FormSupport.REFUSED:
            taken = ", ".join(name for name, how in support.items() if how is not FormSupport.REFUSED)
            given = f"{catalog.facts.model_id} was not trained for constraints of the form {form}"
            raise refuse("UNSUPPORTED_CONSTRAINT", field, given, f"the forms {taken}" if taken else "no constraint")


def untrained_forms(items: Iterable[Asked | SetVelocity], catalog: Catalog) -> dict[str, int]:
    """The forms that the model accepts without having been trained for them, each with the first item that has it."""
    support = catalog.abilities.forms
    found: dict[str, int] = {}
    for index, item in enumerate(items if support else ()):
        for form in forms_of(item, catalog.facts.rig):
            if support.get(form) is FormSupport.UNTRAINED:
                found.setdefault(form, index)
    return found


def _joint_forms(item: JointTargets, rig: RigLayout) -> tuple[str, ...]:
    """The forms of hands and feet include the rotation of their ends; rotations of other joints are separate forms."""
    chains = {limb.name: limb.joints for limb in rig.limbs if limb.name in _LIMB_FORMS}
    limb_of = {joint: _LIMB_FORMS[name] for name, joints in chains.items() for joint in joints}
    forms = [limb_of.get(joint, "joints") for joint in item.joints if joint != 0] or ["root_height"]
    ends = {joints[0] for joints in chains.values()}
    for joint in (item.joints[index] for index in item.turns):
        if joint not in ends:
            forms.append(_rotation_form(joint, rig))
    return tuple(dict.fromkeys(forms))


def _rotation_form(joint: int, rig: RigLayout) -> str:
    return "head_rotation" if rig.joint_names[joint] == HEAD else "joint_rotations"
