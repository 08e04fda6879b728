"""Constraints: what a character is to do at which frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.types.checks import (
    MOST_UINT32,
    as_array,
    as_tuple,
    check_finite,
    check_flag,
    check_frame,
    check_number,
    check_text,
    check_tolerance,
    check_type,
    is_whole,
)


@dataclass(frozen=True)
class Waypoint:
    """The root on the ground at one frame. x_m, z_m: world metres; heading_rad: 0 faces +Z, None leaves it free.

    tolerance_m, tolerance_rad: by how much it may be missed and still count as met, here and in the other constraints;
    None: the model's own (`Model.default_tolerance_m`, `default_tolerance_rad`).
    """

    frame: int
    x_m: float
    z_m: float
    heading_rad: float | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        _check_place(self)


@dataclass(frozen=True, eq=False)
class RootTrajectory:
    """The root on the ground at consecutive frames from `first_frame`.

    positions_m: (N, 2) world x, z in metres; headings_rad: (N,), or None, which leaves the heading free.
    """

    first_frame: int
    positions_m: NDArray[np.float32]
    headings_rad: NDArray[np.float32] | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("first_frame", self.first_frame)
        positions = as_array("positions_m", self.positions_m, (None, 2))
        if len(positions) == 0:
            raise InvalidInput("positions_m", "no position", "one x, z pair or more")
        object.__setattr__(self, "positions_m", positions)
        if self.headings_rad is not None:
            object.__setattr__(self, "headings_rad", as_array("headings_rad", self.headings_rad, (len(positions),)))


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A whole pose at one frame. positions_m: (J, 3) world position of every joint of the rig, metres."""

    frame: int
    positions_m: NDArray[np.float32]
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "positions_m", as_array("positions_m", self.positions_m, (None, 3)))


def _joints(joints: Sequence[int]) -> tuple[int, ...]:
    """Joints as a tuple. Raises InvalidInput if there are none, or for anything that cannot be an index."""
    allowed = "one index of the rig's joints or more"
    given = as_tuple("joints", joints, allowed)
    if not given or not all(is_whole(joint) and 0 <= joint <= MOST_UINT32 for joint in given):
        raise InvalidInput("joints", given, allowed)
    return given


@dataclass(frozen=True, eq=False)
class JointTargets:
    """World targets for some joints (hands, feet) at one frame. The root, if not among them, moves as needed.

    joints: K indices into the rig; positions_m: (K, 3) metres; rotations_quat_wxyz: (K, 4) unit quaternions or None.
    """

    frame: int
    joints: Sequence[int]
    positions_m: NDArray[np.float32]
    rotations_quat_wxyz: NDArray[np.float32] | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "joints", _joints(self.joints))
        positions = as_array("positions_m", self.positions_m, (len(self.joints), 3))
        object.__setattr__(self, "positions_m", positions)
        if self.rotations_quat_wxyz is not None:
            rotations = as_array("rotations_quat_wxyz", self.rotations_quat_wxyz, (len(self.joints), 4))
            object.__setattr__(self, "rotations_quat_wxyz", rotations)


@dataclass(frozen=True)
class HeadingTarget:
    """The root's heading at one frame, wherever the character is: radians, 0 faces +Z."""

    frame: int
    heading_rad: float
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        check_finite("heading_rad", self.heading_rad)


@dataclass(frozen=True, eq=False)
class JointRotations:
    """How some joints are turned at one frame, wherever they are.

    joints: K indices into the rig; rotations_quat_wxyz: (K, 4) unit quaternions, world rotations.
    """

    frame: int
    joints: Sequence[int]
    rotations_quat_wxyz: NDArray[np.float32]
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        check_frame("frame", self.frame)
        object.__setattr__(self, "joints", _joints(self.joints))
        rotations = as_array("rotations_quat_wxyz", self.rotations_quat_wxyz, (len(self.joints), 4))
        object.__setattr__(self, "rotations_quat_wxyz", rotations)


@dataclass(frozen=True, eq=False)
class RootPath:
    """Corners of a path over the ground, walked from where the character is when the change takes effect.

    corners_m: (N, 2) world x, z in metres. speed_mps: on straight parts. smoothing_m: how far corners are cut.
    """

    corners_m: NDArray[np.float32]
    speed_mps: float | None = None
    smoothing_m: float | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_tolerance(self.tolerance_m, self.tolerance_rad)
        corners = as_array("corners_m", self.corners_m, (None, 2))
        if len(corners) == 0:
            raise InvalidInput("corners_m", "no corner", "one x, z pair or more")
        object.__setattr__(self, "corners_m", corners)
        for name in ("speed_mps", "smoothing_m"):
            if getattr(self, name) is not None:
                check_finite(name, getattr(self, name))


@dataclass(frozen=True)
class FootContact:
    """A foot that stands flat at one frame. limb: "LeftFoot" or "RightFoot", of `Rig.limbs`.

    x_m, z_m: world position of the ankle, metres; heading_rad: of the foot, None leaves it free.
    """

    frame: int
    limb: str
    x_m: float
    z_m: float
    heading_rad: float | None = None
    tolerance_m: float | None = None
    tolerance_rad: float | None = None

    def __post_init__(self) -> None:
        check_text("limb", self.limb, "a name of Rig.limbs")
        _check_place(self)


Target = Waypoint | RootTrajectory | Keyframe | JointTargets | HeadingTarget | JointRotations | RootPath | FootContact


def check_target(name: str, target: Target) -> None:
    """Raise InvalidInput unless it is a target, such as a Waypoint."""
    check_type(name, target, Target, "one of: " + ", ".join(kind.__name__ for kind in get_args(Target)))


def _check_place(target: Waypoint | FootContact) -> None:
    check_tolerance(target.tolerance_m, target.tolerance_rad)
    check_frame("frame", target.frame)
    check_finite("x_m", target.x_m)
    check_finite("z_m", target.z_m)
    if target.heading_rad is not None:
        check_finite("heading_rad", target.heading_rad)


@dataclass(frozen=True)
class Flexible:
    """A target that leaves something to the server; `Outcome.placements` says what the server chose.

    last_frame: it may be met at any frame from the target's own to this one. at_any_frame: as soon as a person can be
    there; the target's frame must be 0. frames_from_effect: frames count from when the change takes effect.
    is_relative: places and angles are relative to the character at that moment, x to its left, z ahead. weight: above
    0, at most 10; 1 is a requirement, less is a wish that yields to heavier constraints.
    """

    target: Target
    last_frame: int | None = None
    at_any_frame: bool = False
    frames_from_effect: bool = False
    is_relative: bool = False
    weight: float | None = None

    def __post_init__(self) -> None:
        check_target("target", self.target)
        if self.last_frame is not None:
            check_frame("last_frame", self.last_frame)
        for name in ("at_any_frame", "frames_from_effect", "is_relative"):
            check_flag(name, getattr(self, name))
        if self.weight is not None:
            allowed = "a number above 0, at most 10, or None for 1"
            check_number("weight", self.weight, allowed, lambda weight: 0 < weight <= 10)


Constraint = Target | Flexible
