"""A leg put to a wanted ankle, for all frames of a motion at once: how far it stretches, and where its knee goes.

Positions are metres, matrices act on column vectors, everything is float64.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from motiongen_ardy.core.two_bone import across, bent_to, unit

# No leg is stretched beyond this share of its length: there, small moves of the hip make the knee jump.
MAX_REACH = 0.995
MIN_REACH = 0.25
# What the hinge's own forward counts beside the knee's offset, metres: it decides for a leg that is nearly straight.
HINGE_HINT_M = 0.02


@dataclass(frozen=True)
class SolvedLeg:
    """Global rotations (T, 3, 3) of thigh and shin, and how far (T,) metres the ankle stays short of its goal."""

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
    """Turn a leg as little as can be so that its ankle comes to `goal`.

    hip, goal: (T, 3). thigh, shin: (T, 3, 3) global rotations as they are. knee_bone, ankle_bone: (3,) offsets of knee
    and ankle in the frames of thigh and shin. The knee keeps its side: it bends in the plane in which it is bent now,
    and where it is nearly straight, forward of the thigh's own left axis.
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
