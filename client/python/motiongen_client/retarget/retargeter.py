"""Retargeter: puts motion of one of our rigs on a user's skeleton.

With G(j) the world rotation of our joint j, which is the identity in the neutral pose, and T(k) the orientation of the
axes of the user's joint k in that pose, k has the world rotation G(j) T(k). Joints that nothing drives stay as at rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import forward_kinematics, matrix_to_quaternion, quaternion_to_matrix
from motiongen_client.motion import Motion, Rig
from motiongen_client.retarget.joint_map import Drive, JointMap
from motiongen_client.retarget.skeleton import UserSkeleton
from motiongen_client.sampling import slerp

Float64 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Retargeted:
    """Poses of a user's skeleton, in our axes. Successive quaternions have the nearer sign of q and -q.

    root_translation: (T, 3) in the skeleton's units; joint_rotation_quat_wxyz: (T, J, 4) relative to the parent, joint
    0 relative to the world.
    """

    skeleton: UserSkeleton
    root_translation: Float64
    joint_rotation_quat_wxyz: Float64

    def joint_positions(self) -> Float64:
        """(T, J, 3) world positions in the skeleton's units."""
        positions, _ = forward_kinematics(
            self.skeleton.parents, self.skeleton.offsets, self.root_translation, self.joint_rotation_quat_wxyz
        )
        return np.asarray(positions, np.float64)


class Retargeter:
    """Retargets motion of one rig to one skeleton.

    Raises UnknownName for joints of the map that do not exist, and InvalidInput if scale or ground cannot be measured:
    bones without length, or feet that drive none of the skeleton's joints.
    """

    def __init__(self, rig: Rig, joint_map: JointMap, skeleton: UserSkeleton) -> None:
        self._rig = rig
        self._map = joint_map
        self._skeleton = skeleton
        drives = {skeleton.index(theirs): drive for theirs, drive in joint_map.drives.items()}
        self._drives: list[tuple[int, Drive, tuple[int, int]]] = [
            (joint, drive, (rig.index(drive.ours[0]), rig.index(drive.ours[1]))) for joint, drive in drives.items()
        ]
        self._rest = quaternion_to_matrix(skeleton.rest)
        self._middle_theirs = [skeleton.index(name) for name in joint_map.root_theirs]
        self._middle_ours = [rig.index(name) for name in joint_map.root_ours]
        self.scale = self._scale()
        """Metres of ours per metre of theirs."""
        self._lift_m = self._lift()

    def apply(self, motion: Motion, before: Float64 | None = None) -> Retargeted:
        """The poses for a motion of the rig. before: (J, 4) quaternions of the frame before, for continuous signs."""
        positions, rotations = forward_kinematics(
            self._rig.parents,
            self._rig.offsets_m,
            motion.root_translation_m.astype(np.float64),
            motion.joint_rotation_quat_wxyz.astype(np.float64),
        )
        unit = self._map.metres_per_unit
        local, bodies = self._posed(np.asarray(rotations, np.float64))
        middle_m = positions[:, self._middle_ours].mean(axis=1) / self.scale + [0.0, self._lift_m, 0.0]
        root = middle_m / unit - bodies[:, self._middle_theirs].mean(axis=1)
        return Retargeted(self._skeleton, root, _continued(matrix_to_quaternion(local), before))

    def _posed(self, ours: Float64) -> tuple[Float64, Float64]:
        """Local rotations (T, J, 3, 3) and joint positions (T, J, 3) relative to the root, in the skeleton's units.

        ours: (T, J', 3, 3) world rotations.
        """
        num_frames, parents, offsets = len(ours), self._skeleton.parents, self._skeleton.offsets
        driven: dict[int, Float64] = {}
        for joint, drive, (first, second) in self._drives:
            turn: NDArray[np.floating[Any]] = ours[:, first]
            if first != second:
                ends = (matrix_to_quaternion(turn), matrix_to_quaternion(ours[:, second]))
                turn = quaternion_to_matrix(slerp(*ends, drive.fraction))
            driven[joint] = turn @ drive.axes
        world = np.empty((num_frames, len(parents), 3, 3))
        local, positions = np.empty_like(world), np.zeros((num_frames, len(parents), 3))
        for joint, parent in enumerate(parents):
            above = np.broadcast_to(np.eye(3), (num_frames, 3, 3)) if parent < 0 else world[:, parent]
            world[:, joint] = driven[joint] if joint in driven else above @ self._rest[joint]
            local[:, joint] = np.swapaxes(above, -1, -2) @ world[:, joint]
            if parent >= 0:
                positions[:, joint] = positions[:, parent] + above @ offsets[joint]
        return local, positions

    def _scale(self) -> float:
        if self._map.scale is not None:
            return self._map.scale
        chains_theirs, chains_ours = self._map.leg_chains
        theirs = np.mean([self._skeleton.chain_length(chain) for chain in chains_theirs])
        lengths = np.linalg.norm(self._rig.offsets_m.astype(np.float64), axis=1)
        ours = np.mean([sum(lengths[self._rig.index(name)] for name in chain[1:]) for chain in chains_ours])
        for name, length in (("from", theirs), ("to", ours)):
            if not length > 0:
                raise InvalidInput(f"root.scale.{name}", "bones without length", "joints that are apart")
        return float(ours / (theirs * self._map.metres_per_unit))

    def _lift(self) -> float:
        """Metres by which the midpoint of theirs is above the scaled midpoint of ours."""
        unit, height_m = self._map.metres_per_unit, self._map.ground_ours_m
        if self._map.ground_theirs is not None:
            return self._map.ground_theirs * unit - height_m / self.scale
        neutral = np.broadcast_to(np.eye(3), (1, self._rig.num_joints, 3, 3))
        ours, _ = forward_kinematics(
            self._rig.parents,
            self._rig.offsets_m.astype(np.float64),
            np.zeros((1, 3)),
            np.tile([1.0, 0.0, 0.0, 0.0], (1, self._rig.num_joints, 1)),
        )
        _, theirs = self._posed(np.asarray(neutral, np.float64))
        feet_ours = [self._rig.index(name) for name in self._map.feet_ours]
        feet_theirs = [joint for joint, drive, _ in self._drives if drive.ours[0] in self._map.feet_ours]
        if not feet_theirs:
            raise InvalidInput("root.ground.lowest_of", self._map.feet_ours, "joints that drive one of theirs")
        rest = self._skeleton.rest_positions()
        stands_at = rest[feet_theirs, 1].min() - rest[:, 1].min()
        middle_theirs = stands_at - theirs[0, feet_theirs, 1].min() + theirs[0, self._middle_theirs, 1].mean()
        middle_ours = height_m - ours[0, feet_ours, 1].min() + ours[0, self._middle_ours, 1].mean()
        return float(middle_theirs * unit - middle_ours / self.scale)


def _continued(quaternions: NDArray[np.floating], before: Float64 | None) -> Float64:
    """(T, J, 4) with signs that are continuous from frame to frame."""
    last = quaternions[:1] if before is None else before[None]
    dots = (quaternions * np.concatenate([last, quaternions[:-1]])).sum(axis=-1, keepdims=True)
    return np.asarray(quaternions * np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0), np.float64)
