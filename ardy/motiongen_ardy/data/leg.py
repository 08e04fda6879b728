"""Two-bone inverse kinematics of a leg for all frames of a motion at once: how far it stretches, where its knee goes.

Positions are in metres, matrices act on column vectors, and everything is float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from motiongen_ardy.core.two_bone import across, bent_to, unit

# The most that a leg is stretched, as a share of its length: beyond it, small moves of the hip make the knee jump.
MAX_REACH = 0.995
MIN_REACH = 0.25
# Weight of the hinge's own forward direction against the knee's offset, metres: decides for a nearly straight leg.
HINGE_HINT_M = 0.02


@dataclass(frozen=True)
class SolvedLeg:
    """Global rotations (T, 3, 3) of thigh and shin, and by how much (T,) in metres the ankle misses its goal."""

    thigh: np.ndarray
    shin: np.ndarray
    short_m: np.ndarray


def solve_leg(
    hip: np.ndarray,
    goal: np.ndarray,
    thigh: np.ndarray,
    shin: np.ndarray,
    knee_bone: np.ndarray,
    ankle_bone: np.ndarray,
) -> SolvedLeg:
    """Turn a leg as little as possible so that its ankle reaches `goal`.

    hip, goal: (T, 3). thigh, shin: (T, 3, 3), present global rotations. knee_bone, ankle_bone: (3,), offsets of knee
    and ankle in the frames of thigh and shin. The knee keeps its side: it bends in the plane in which it is bent now
    or, if it is nearly straight, forward relative to the thigh's own left axis.
    """
    upper, target = torch.from_numpy(hip), torch.from_numpy(goal)
    rotations = torch.from_numpy(thigh), torch.from_numpy(shin)
    knee = upper + rotations[0] @ torch.tensor(knee_bone)
    ankle = knee + rotations[1] @ torch.tensor(ankle_bone)
    length = float(np.linalg.norm(knee_bone) + np.linalg.norm(ankle_bone))
    wanted = (target - upper).norm(dim=-1)
    distance = wanted.clamp(MIN_REACH * length, MAX_REACH * length)
    line = unit(ankle - upper)
    ahead = torch.linalg.cross(line, rotations[0][..., 0])
    outward = unit(across(knee - upper, line) + HINGE_HINT_M * unit(ahead))
    turned = bent_to((upper, knee, ankle), rotations, unit(target - upper), distance, outward)
    return SolvedLeg(turned[0].numpy(), turned[1].numpy(), (wanted - distance).clamp(min=0).numpy())
