"""Ground: adapts motion on a level floor to ground of any heights, by moving only the hips and legs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, UnknownName
from motiongen_client.ground.lifts import averaged, covering, standing_lift, swing_lift
from motiongen_client.ground.limb_ik import rotation_between, two_bone
from motiongen_client.kinematics import forward_kinematics, matrix_to_quaternion
from motiongen_client.motion import ROOT_BLOCK, ROTATION_BLOCK, Motion, Rig

Float64 = NDArray[np.float64]
Heights: TypeAlias = Callable[[Float64, Float64], NDArray[np.floating]]
"""A function: world x (N,) and z (N,) -> the ground's heights (N,), metres."""

SOLE_M = 0.0152
"""Height of the lowest joint of a standing foot above the floor."""
_FEET = (("LeftFoot", slice(0, 2)), ("RightFoot", slice(2, 4)))
_HIP_FRAMES = 5  # to each side, over which the height of the hips is averaged
_STRETCH = 0.995
_ROUNDS = 3


@dataclass(frozen=True)
class _Leg:
    """The joints from hip to toes, and this foot's numbers in foot_contact."""

    hip: int
    knee: int
    ankle: int
    toes: int
    contacts: slice


class Ground:
    """Puts motion of one rig on the ground. Raises InvalidInput if the rig's legs do not have two bones each."""

    def __init__(self, rig: Rig, heights: Heights) -> None:
        self.rig = rig
        self._heights = heights
        self._legs = [_leg(rig, name, contacts) for name, contacts in _FEET]
        offsets = rig.offsets_m.astype(np.float64)
        self._stands_at = [SOLE_M + max(-offsets[leg.toes][1], 0.0) for leg in self._legs]

    def apply(self, motion: Motion) -> Motion:
        """The same motion, without outputs, on this ground.

        A standing foot is on the ground below its ankle and toes; on the edge of a step it is level, at the upper
        height. In the air it moves from where it stood to where it will stand. The hips follow, low enough for the legs
        to reach.
        """
        motion = motion.own()
        root = motion.root_translation_m.astype(np.float64)
        local = motion.joint_rotation_quat_wxyz.astype(np.float64)
        found, turns = forward_kinematics(self.rig.parents, self.rig.offsets_m.astype(np.float64), root, local)
        positions, rotations = np.asarray(found, np.float64), np.asarray(turns, np.float64)
        goals = [
            self._foot(leg, stand, positions, motion) for leg, stand in zip(self._legs, self._stands_at, strict=True)
        ]
        hips = self._hips([ankle for ankle, _ in goals], positions)
        rows = motion.rows.copy()
        columns = self.rig.block_columns
        rows[:, columns[ROOT_BLOCK].start + 1] += hips.astype(np.float32)
        for leg, (ankle, foot) in zip(self._legs, goals, strict=True):
            quaternions = rows[:, columns[ROTATION_BLOCK]]
            self._bend(leg, ankle, foot, hips=hips, positions=positions, rotations=rotations, quaternions=quaternions)
        return Motion(motion.rig, motion.first_frame, rows)

    @cached_property
    def leg_columns(self) -> NDArray[np.intp]:
        """(6, 4) the columns of the rotations that `apply` changes."""
        start = self.rig.block_columns[ROTATION_BLOCK].start
        joints = np.array([joint for leg in self._legs for joint in (leg.hip, leg.knee, leg.ankle)])
        columns: NDArray[np.intp] = start + 4 * joints[:, None] + np.arange(4)
        return columns

    def height(self, points: Float64) -> Float64:
        """(T,) the ground's height below points (T, 3). Raises InvalidInput if `heights` returns anything else."""
        given = np.asarray(self._heights(points[:, 0], points[:, 2]), np.float64)
        if given.shape != (len(points),) or not np.isfinite(given).all():
            allowed = f"{len(points)} finite metres, one for each x and z"
            raise InvalidInput("heights", f"an array of shape {given.shape}", allowed)
        return given

    def _foot(self, leg: _Leg, stands_at: float, positions: Float64, motion: Motion) -> tuple[Float64, Float64]:
        """The goal for the ankle, and the vector from ankle to toes: (T, 3) each."""
        ankle, toes = positions[:, leg.ankle], positions[:, leg.toes]
        planted = np.asarray(motion.foot_contact[:, leg.contacts].max(axis=1) > 0.5)
        below = self.height(ankle)
        lift = swing_lift(standing_lift(below, planted), below, planted, ankle[:, 1] - stands_at)
        foot = toes - ankle
        length = np.linalg.norm(foot, axis=1)
        level = foot * [1.0, 0.0, 1.0]
        level_length = np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-6)
        lies = foot
        for _ in range(_ROUNDS):  # the toes move over the ground as the foot tilts
            under = self.height(ankle + lies)
            lifted = swing_lift(standing_lift(under, planted), under, planted, toes[:, 1] - SOLE_M)
            steep = np.abs(lifted - lift) > level_length[:, 0]
            upper = np.maximum(lift, lifted)
            drop = np.clip(foot[:, 1] + np.where(steep, 0.0, lifted - lift), -0.95 * length, 0.95 * length)
            lies = level / level_length * np.sqrt(length**2 - drop**2)[:, None] + drop[:, None] * [0.0, 1.0, 0.0]
        goal = ankle.copy()
        goal[:, 1] += np.where(steep & planted, upper, lift)
        return goal, np.asarray(lies, np.float64)

    def _hips(self, ankles: list[Float64], positions: Float64) -> Float64:
        """(T,) metres by which to lift the hips: the mean lift of the feet, less if a leg would be too short."""
        wanted = np.mean(
            [goal[:, 1] - positions[:, leg.ankle, 1] for leg, goal in zip(self._legs, ankles, strict=True)], 0
        )
        wanted = averaged(wanted, _HIP_FRAMES)
        missing = np.zeros(len(wanted))
        for leg, goal in zip(self._legs, ankles, strict=True):
            hip, ankle = positions[:, leg.hip], positions[:, leg.ankle]
            bones = np.linalg.norm(self.rig.offsets_m[[leg.knee, leg.ankle]].astype(np.float64), axis=1).sum()
            longest = np.maximum(_STRETCH * bones, np.linalg.norm(ankle - hip, axis=1))
            aside = np.hypot(goal[:, 0] - hip[:, 0], goal[:, 2] - hip[:, 2])
            highest = goal[:, 1] - hip[:, 1] + np.sqrt(np.maximum(longest**2 - aside**2, 0.0))
            missing = np.maximum(missing, wanted - highest)
        return wanted - covering(missing, _HIP_FRAMES)

    def _bend(
        self,
        leg: _Leg,
        ankle: Float64,
        foot: Float64,
        *,
        hips: Float64,
        positions: Float64,
        rotations: Float64,
        quaternions: NDArray[np.float32],
    ) -> None:
        """Turn a leg so that ankle and foot reach their goals. quaternions: (T, 4 J), changed in place."""
        up = np.zeros_like(ankle)
        up[:, 1] = hips
        hip, knee = positions[:, leg.hip] + up, positions[:, leg.knee] + up
        first, second = two_bone(hip, knee, positions[:, leg.ankle] + up, ankle, rotations[:, 0, :, 2])
        tilt = rotation_between(positions[:, leg.toes] - positions[:, leg.ankle], foot)
        world = (
            rotations[:, self.rig.parents[leg.hip]],
            first @ rotations[:, leg.hip],
            second @ rotations[:, leg.knee],
            tilt @ rotations[:, leg.ankle],
        )
        for joint, above, turned in zip((leg.hip, leg.knee, leg.ankle), world, world[1:], strict=False):
            before = quaternions[:, 4 * joint : 4 * joint + 4]
            now = matrix_to_quaternion(np.swapaxes(above, -1, -2) @ turned)
            signs = np.where((now * before).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
            quaternions[:, 4 * joint : 4 * joint + 4] = now * signs


def _leg(rig: Rig, name: str, contacts: slice) -> _Leg:
    if name not in rig.limbs:
        raise UnknownName("limb", name, list(rig.limbs))
    if len(rig.limbs[name]) < 2:
        raise InvalidInput("rig", rig.rig_id, f"one whose {name} has toes besides the ankle")
    ankle, toes = rig.limbs[name][0], rig.limbs[name][1]
    knee = rig.parents[ankle]
    hip = rig.parents[knee]
    bones = np.linalg.norm(rig.offsets_m[[knee, ankle]], axis=1)
    if hip <= 0 or bones.min() < 0.5 * bones.max():
        raise InvalidInput("rig", rig.rig_id, f"one whose {name} hangs on a thigh and a shin")
    return _Leg(hip, knee, ankle, toes, contacts)
