"""Knees: hinges that bend and do not turn, so that a shin is turned about itself as its thigh is.

Where a shin points is seen in the place of the foot; how it is turned about itself is in nothing but its own rotation,
which a decoder may have learned badly: captured knees turn by less than 6 degrees in 98 frames of 100, decoded shins
can spin, and what is smoothed or held after them then jerks the feet. Only the shins' own rotations change here.
"""

from __future__ import annotations

from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import matrix_to_6d
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.core.two_bone import swing, unit


def hinge_knees(layout: Representation, frames: Tensor) -> Tensor:
    """Frames (B, T, D), in natural units, with shins that are bent from their thighs on the shortest way.

    Skeletons whose legs are not thigh, shin and foot stay as they are.
    """
    found = _shins(layout.skeleton)
    if not found:
        return frames
    thighs, shins, feet = (list(joints) for joints in zip(*found, strict=True))
    rotations = layout.global_rotations(frames)
    along = unit(rotations.new_tensor([layout.skeleton.offsets[foot].tolist() for foot in feet]))[..., None]
    thigh, shin = rotations[:, :, thighs], rotations[:, :, shins]
    bent = swing((thigh @ along).squeeze(-1), (shin @ along).squeeze(-1)) @ thigh
    sixd = frames[..., layout.rotation_block].unflatten(-1, (-1, 6)).clone()
    sixd[:, :, shins] = matrix_to_6d(bent)
    hinged = frames.clone()
    hinged[..., layout.rotation_block] = sixd.flatten(-2)
    return hinged


def _shins(skeleton: Skeleton) -> list[tuple[int, int, int]]:
    """Thigh, shin and ankle of each leg that has one of each."""
    legs = []
    for chain in (skeleton.left_foot, skeleton.right_foot):
        shin = skeleton.parents[chain[0]]
        if skeleton.parents[shin] in skeleton.hip_joints:
            legs.append((skeleton.parents[shin], shin, chain[0]))
    return legs
