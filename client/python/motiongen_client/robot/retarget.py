"""G1Retargeter: turns motion of a person's rig into states of the robot, within its joint ranges and speeds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import forward_kinematics, matrix_to_quaternion
from motiongen_client.motion import Motion, Rig
from motiongen_client.retarget.joint_map import directions
from motiongen_client.robot.chains import Chain
from motiongen_client.robot.g1 import LOWER, QPOS_WIDTH, QVEL_WIDTH, SPEED_LIMITS, TO_ROBOT, UPPER

Float64 = NDArray[np.float64]

_STANDS_AT_M = 0.793
"""Height of the robot's root above the ground when it stands at angles 0; its legs measure _LEG_M to the ankle."""
_LEG_M = 0.649
SOLE_M = 0.0152

# For each body: the directions of its own axes, which at angles 0 point left, up and forward, when a person stands in
# the neutral pose with arms held out. At angles 0 the robot's arms hang, and its forearms point ahead.
_BODIES = {
    "Hips": "left up forward",
    "Spine3": "left up forward",
    "LeftUpLeg": "left up forward",
    "LeftLeg": "left up forward",
    "LeftFoot": "left up forward",
    "RightUpLeg": "left up forward",
    "RightLeg": "left up forward",
    "RightFoot": "left up forward",
    "LeftArm": "up right forward",
    "LeftForeArm": "up forward left",
    "LeftHand": "up forward left",
    "RightArm": "down left forward",
    "RightForeArm": "down forward right",
    "RightHand": "down forward right",
}
# The joint that a chain moves, the joint that it is attached to, and its hinges.
_CHAINS = (
    ("LeftUpLeg", "Hips", "left_hip_pitch left_hip_roll left_hip_yaw"),
    ("LeftLeg", "LeftUpLeg", "left_knee"),
    ("LeftFoot", "LeftLeg", "left_ankle_pitch left_ankle_roll"),
    ("RightUpLeg", "Hips", "right_hip_pitch right_hip_roll right_hip_yaw"),
    ("RightLeg", "RightUpLeg", "right_knee"),
    ("RightFoot", "RightLeg", "right_ankle_pitch right_ankle_roll"),
    ("Spine3", "Hips", "waist_yaw waist_roll waist_pitch"),
    ("LeftArm", "Spine3", "left_shoulder_pitch left_shoulder_roll left_shoulder_yaw"),
    ("LeftForeArm", "LeftArm", "left_elbow"),
    ("LeftHand", "LeftForeArm", "left_wrist_roll left_wrist_pitch left_wrist_yaw"),
    ("RightArm", "Spine3", "right_shoulder_pitch right_shoulder_roll right_shoulder_yaw"),
    ("RightForeArm", "RightArm", "right_elbow"),
    ("RightHand", "RightForeArm", "right_wrist_roll right_wrist_pitch right_wrist_yaw"),
)


@dataclass(frozen=True, eq=False)
class G1Motion:
    """States of the robot, a row a frame.

    qpos: (T, 36), every angle in its range, and no joint above its speed limit from row to row; qvel: (T, 35), the
    velocity from the row before to each row. lost_rad: (T, 13), the error of each of the person's joints.
    """

    qpos: Float64
    qvel: Float64
    lost_rad: Float64


class G1Retargeter:
    """Retargets motion of a person's rig, Core-27, to the robot.

    Each chain is solved relative to the body above it as that body turned out, so that an arm points as asked even if
    the waist cannot bend far enough. Distances over the ground are scaled by the ratio of leg lengths.
    """

    def __init__(self, rig: Rig) -> None:
        absent = [name for name in _BODIES if name not in rig.joint_names]
        if absent:
            raise InvalidInput("rig", rig.rig_id, f"one that has the joints {', '.join(absent)} as well")
        self._rig = rig
        self._axes = {name: directions(words.split()) for name, words in _BODIES.items()}
        self._chains = [(moved, base, Chain(hinges.split())) for moved, base, hinges in _CHAINS]
        # At angles 0 not all bodies are turned like the root: thighs lean, while shins are upright.
        at_rest = {"Hips": np.eye(3)}
        for moved, base, chain in self._chains:
            at_rest[moved] = at_rest[base] @ chain.rotation(np.zeros((1, len(chain.indices))))[0]
        self._at_rest = at_rest
        offsets = rig.offsets_m.astype(np.float64)
        legs = [rig.index(name) for name in ("LeftUpLeg", "LeftLeg", "LeftFoot", "LeftToeBase")]
        self.scale = float(_LEG_M / np.linalg.norm(offsets[legs[1:3]], axis=1).sum())
        """Metres of the robot per metre of the person."""
        self._person_stands_at = SOLE_M - float(offsets[legs, 1].sum())

    def apply(self, motion: Motion, before: Float64 | None = None) -> G1Motion:
        """States for the frames of a motion. before: (36,), the qpos of the frame before; None for the first frame."""
        root = motion.root_translation_m.astype(np.float64)
        _, rotations = forward_kinematics(
            self._rig.parents, self._rig.offsets_m, root, motion.joint_rotation_quat_wxyz.astype(np.float64)
        )
        fps, count = self._rig.frame_rate_hz, len(motion)
        asked = {
            name: TO_ROBOT @ (rotations[:, self._rig.index(name)] @ axes) @ TO_ROBOT.T @ self._at_rest[name]
            for name, axes in self._axes.items()
        }
        qpos = np.zeros((count, QPOS_WIDTH))
        qpos[:, :3] = self._root(root)
        qpos[:, 3:7] = matrix_to_quaternion(asked["Hips"])
        lost = np.zeros((count, len(self._chains)))
        made: dict[str, NDArray[np.floating[Any]]] = {"Hips": asked["Hips"]}
        for number, (moved, base, chain) in enumerate(self._chains):
            columns = [7 + index for index in chain.indices]
            start = np.zeros((count, len(columns))) if before is None else np.tile(before[columns], (count, 1))
            relative = np.asarray(np.swapaxes(made[base], -1, -2) @ asked[moved], np.float64)
            qpos[:, columns], lost[:, number] = chain.angles(relative, start)
            made[moved] = made[base] @ chain.rotation(qpos[:, columns])
        return self._kept(qpos, lost, before, fps)

    def _root(self, root: Float64) -> Float64:
        """(T, 3) root translations of the robot, in robot axes."""
        placed = self.scale * (root - [0.0, self._person_stands_at, 0.0]) + [0.0, _STANDS_AT_M, 0.0]
        return np.asarray(placed @ TO_ROBOT.T, np.float64)

    def _kept(self, qpos: Float64, lost: Float64, before: Float64 | None, fps: int) -> G1Motion:
        """Keep quaternion signs continuous, and joints within their ranges and speeds."""
        qvel, last = np.zeros((len(qpos), QVEL_WIDTH)), before
        most = SPEED_LIMITS / fps
        for row, speed in zip(qpos, qvel, strict=True):
            row[7:] = np.clip(row[7:], LOWER, UPPER)
            if last is not None:
                if row[3:7] @ last[3:7] < 0:
                    row[3:7] *= -1
                row[7:] = last[7:] + np.clip(row[7:] - last[7:], -most, most)
                speed[:3] = (row[:3] - last[:3]) * fps
                speed[3:6] = _turn(last[3:7], row[3:7]) * fps
                speed[6:] = (row[7:] - last[7:]) * fps
            last = row
        return G1Motion(qpos, qvel, lost)


def _turn(start: Float64, end: Float64) -> Float64:
    """(3,) axis times angle, in the axes of `start`, from one unit quaternion (4,) to another near it."""
    real = float(start @ end)
    imaginary = start[0] * end[1:] - end[0] * start[1:] - np.cross(start[1:], end[1:])
    sine = float(np.linalg.norm(imaginary))
    factor = 2.0 if sine < 1e-12 else 2.0 * np.arctan2(sine, real) / sine
    return np.asarray(factor * imaginary, np.float64)
