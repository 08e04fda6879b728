"""Figures by which a derived clip is kept or dropped; captures are measured by the same figures."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.poses import global_pose

MOVING_M_S = 0.3
# As for the features: a foot joint is in contact if it is slower and lower than this.
CONTACT_M_S = 0.3
CONTACT_M = 0.1


@dataclass(frozen=True)
class Quality:
    """skate_m_s: mean horizontal speed of foot joints that are in contact, as for the features.

    slowest_ratio, slowest_p90: median and 90th percentile, over moving frames, of the slowest foot joint's horizontal
    speed over the root's; 0 if there are none. knee_deg: the largest turn of a knee from frame to frame. acceleration:
    99th percentile over joints and frames, m/s2. lowest_m: the height of the lowest foot joint. lifted_m: the 95th
    percentile of the height of the lower foot's lowest joint, which shows how far the body floats.
    """

    skate_m_s: float
    slowest_ratio: float
    slowest_p90: float
    acceleration: float
    knee_deg: float
    lowest_m: float
    lifted_m: float

    def rounded(self) -> dict[str, float]:
        return {name: round(value, 4) for name, value in asdict(self).items()}


def quality(skeleton: Skeleton, quaternions: np.ndarray, root: np.ndarray, fps: float) -> Quality:
    """Measure one motion: quaternions (T, J, 4), root (T, 3) metres, T at least 4."""
    rotations, positions = global_pose(skeleton, quaternions, root)
    feet = positions[:, list(skeleton.contact_joints)]
    speed = np.linalg.norm(np.diff(feet, axis=0)[..., [0, 2]], axis=-1) * fps
    low = feet[:-1, :, 1] < CONTACT_M
    grounded = low & (np.linalg.norm(np.diff(feet, axis=0), axis=-1) * fps < CONTACT_M_S)
    pace = np.linalg.norm(np.diff(root, axis=0)[:, [0, 2]], axis=-1) * fps
    moving = pace > MOVING_M_S
    ratio = speed.min(-1)[moving] / pace[moving] if moving.any() else np.zeros(1)
    acceleration = np.linalg.norm(np.diff(positions, n=2, axis=0), axis=-1) * fps**2
    knees = []
    for chain, hip in ((skeleton.left_foot, skeleton.hip_joints[1]), (skeleton.right_foot, skeleton.hip_joints[0])):
        knee = skeleton.parents[chain[0]]
        relative = np.swapaxes(rotations[:, hip], -1, -2) @ rotations[:, knee]
        trace = np.einsum("tii->t", np.swapaxes(relative[:-1], -1, -2) @ relative[1:])
        knees.append(np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1))).max())
    return Quality(
        skate_m_s=float(speed[grounded].mean()) if grounded.any() else 0.0,
        slowest_ratio=float(np.median(ratio)),
        slowest_p90=float(np.quantile(ratio, 0.9)),
        acceleration=float(np.quantile(acceleration, 0.99)),
        knee_deg=float(max(knees)),
        lowest_m=float(feet[..., 1].min()),
        lifted_m=float(np.quantile(feet[..., 1].min(-1), 0.95)),
    )
