"""Bodies for tests of the client: Core-27 as a rig, and motion for it by formula."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from motiongen_client import Motion, Rig
from motiongen_client.ground.limb_ik import two_bone
from motiongen_client.kinematics import axis_angle_to_quaternion, matrix_to_quaternion

FPS = 20
SKELETONS = Path(__file__).resolve().parents[2] / "ardy" / "motiongen_ardy" / "skeletons"


def client_rig(name: str = "core27") -> Rig:
    """One of our rigs as in the catalogue."""
    facts = json.loads((SKELETONS / f"{name}.json").read_text(encoding="utf-8"))  # the client does not need the library
    names, parents = tuple(facts["joint_names"]), tuple(facts["parents"])
    places = np.array(facts["neutral_joints_m"])

    def indices(key: str) -> tuple[int, ...]:
        return tuple(names.index(joint) for joint in facts[key])

    right_hip, left_hip = indices("hip_joints_right_left")
    return Rig(
        rig_id=name,
        joint_names=names,
        parents=parents,
        offsets_m=(places - places[np.maximum(parents, 0)]).astype(np.float32),
        frame_rate_hz=FPS,
        blocks={"root_translation_m": 3, "joint_rotation_quat_wxyz": 4 * len(names), "foot_contact": 4},
        hip_joints=(right_hip, left_hip),
        limbs={"LeftFoot": indices("left_foot_chain"), "RightFoot": indices("right_foot_chain")},
    )


def swaying(rig: Rig, frames: int = 40, most_rad: float = 0.6) -> Motion:
    """Every joint sways about its own axis while the root moves ahead and turns."""
    generator, time = np.random.default_rng(11), np.arange(frames)[:, None, None] / FPS
    axes = generator.normal(size=(rig.num_joints, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    angles = most_rad * np.sin(2 * time + generator.uniform(0, 6, (rig.num_joints, 1)))
    turns = axis_angle_to_quaternion(angles * axes)
    rows = np.zeros((frames, rig.row_width), np.float32)
    rows[:, :3] = np.array([0.3, 0.93, -0.2]) + time[:, 0] * [0.4, 0.02, 1.1]
    rows[:, 3:-4] = turns.reshape(frames, -1)
    return Motion(rig, 0, rows)


def walking(rig: Rig, frames: int = 80, speed_mps: float = 1.2, flat_m: float = 0.0737) -> Motion:
    """A walk toward +Z on a level floor, with feet that are still while in contact, and ankles at flat_m."""
    time = np.arange(frames) / FPS
    rows = np.zeros((frames, rig.row_width), np.float32)
    rows[:, 3:-4:4] = 1.0
    rows[:, 1], rows[:, 2] = 0.88, speed_mps * time
    neutral = Motion(rig, 0, rows).joint_positions_m().astype(np.float64)
    quaternions = rows[:, 3:-4]
    for index, name in enumerate(("LeftFoot", "RightFoot")):
        ankle = rig.limbs[name][0]
        knee, hip = rig.parents[ankle], rig.parents[rig.parents[ankle]]
        phase, stand = time + 0.5 * index, 0.6
        step, within = np.floor(phase), phase % 1.0
        in_air = np.clip((within - stand) / (1 - stand), 0.0, 1.0)
        goal = neutral[:, ankle].copy()
        goal[:, 1] = flat_m + 0.12 * np.sin(np.pi * in_air)
        goal[:, 2] = speed_mps * (step + in_air - 0.5 * index + stand / 2)
        ahead = np.tile([0.0, 0.0, 1.0], (frames, 1))
        first, second = two_bone(neutral[:, hip], neutral[:, knee], neutral[:, ankle], goal, ahead)
        level = np.swapaxes(second, -1, -2)  # the foot stays level
        for joint, turn in ((hip, first), (knee, np.swapaxes(first, -1, -2) @ second), (ankle, level)):
            quaternions[:, 4 * joint : 4 * joint + 4] = matrix_to_quaternion(turn)
        start = rig.block_columns["foot_contact"].start + 2 * index
        rows[:, start : start + 2] = (within <= stand)[:, None]
    return Motion(rig, 0, rows)
