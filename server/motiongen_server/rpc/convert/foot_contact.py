"""The protocol's foot contacts -> joint targets: where the joints of a flat foot are, and its contact channels."""

from __future__ import annotations

import math

import numpy as np

from motiongen.v1 import motion_pb2
from motiongen_server.engine.types import JointTargets, RigLayout
from motiongen_server.engine.types.facts import CONTACT_BLOCK
from motiongen_server.rpc.convert.checks import check_coordinates, heading_of, refuse

SOLE_M = 0.0152
"""Height of a standing foot's lowest joint above the ground."""
_CONTACTS = {"LeftFoot": (0, 1), "RightFoot": (2, 3)}


def foot_contact_of(
    message: motion_pb2.FootContact, identifier: int, frame: int, field: str, rig: RigLayout
) -> JointTargets:
    """Targets for the ankle and, if a heading is given, for the foot's other joints ahead of it.

    Raises EventRefused.
    """
    feet = {limb.name: limb.joints for limb in rig.limbs if limb.name in _CONTACTS and len(limb.joints) > 1}
    has_contacts = any(block.name == CONTACT_BLOCK for block in rig.blocks)
    if message.limb not in feet or not has_contacts:
        allowed = " or ".join(feet) if has_contacts and feet else "another target: this rig has no feet"
        raise refuse("UNKNOWN_LIMB", f"{field}.limb", f"no foot {message.limb[:80]!r}", allowed)
    check_coordinates((message.x,), f"{field}.x")
    check_coordinates((message.z,), f"{field}.z")
    heading, chain = heading_of(message, field), feet[message.limb]
    places = np.zeros((len(chain), 3))
    for index, joint in enumerate(chain[1:], 1):
        places[index] = places[index - 1] + rig.neutral_offsets[joint]
    places[:, 1] += SOLE_M - places[:, 1].min()
    cos, sin = (1.0, 0.0) if heading is None else (math.cos(heading), math.sin(heading))
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    positions = (places @ turn.T + [message.x, 0.0, message.z]).astype(np.float32)
    count = 1 if heading is None else len(chain)
    return JointTargets(identifier, frame, chain[:count], positions[:count], contacts=_CONTACTS[message.limb])
