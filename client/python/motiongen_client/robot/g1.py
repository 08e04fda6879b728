"""The hinges of the Unitree G1, in the order of its simulators and controllers.

Robot axes: X forward, Y left, Z up. A qpos is the root's x, y, z (metres), its quaternion w, x, y, z, and 29 angles; a
qvel is the root's velocity in the world (m/s), its angular velocity in its own axes (rad/s), and 29 speeds (rad/s).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources

import numpy as np
from numpy.typing import NDArray

Float64 = NDArray[np.float64]

QPOS_WIDTH, QVEL_WIDTH = 36, 35
TO_ROBOT = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""A, from our axes (X left, Y up, Z forward) to the robot's: p_robot = A p, R_robot = A R A^T."""


@dataclass(frozen=True)
class Hinge:
    """One hinge. quaternion_wxyz: its body relative to the parent body at angle 0; axis: in the body's frame."""

    name: str
    quaternion_wxyz: tuple[float, float, float, float]
    axis: tuple[float, float, float]
    range_rad: tuple[float, float]
    speed_limit_rad_s: float


def _hinges() -> tuple[Hinge, ...]:
    text = (resources.files("motiongen_client") / "robot" / "g1.json").read_text(encoding="utf-8")
    return tuple(
        Hinge(
            name=entry["name"],
            quaternion_wxyz=tuple(entry["quaternion_wxyz"]),
            axis=tuple(entry["axis"]),
            range_rad=tuple(entry["range_rad"]),
            speed_limit_rad_s=entry["speed_limit_rad_s"],
        )
        for entry in json.loads(text)["hinges"]
    )


HINGES = _hinges()
LOWER = np.array([hinge.range_rad[0] for hinge in HINGES])
UPPER = np.array([hinge.range_rad[1] for hinge in HINGES])
SPEED_LIMITS = np.array([hinge.speed_limit_rad_s for hinge in HINGES])
INDEX = {hinge.name: index for index, hinge in enumerate(HINGES)}
