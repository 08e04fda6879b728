"""Writes motion as BVH, a format that animation tools read.

Lengths are in centimetres by default, as most tools expect; angles are in degrees. Every joint has its rotation
channels in the order Z, X, Y: the heading is the last angle, so turning round never reaches the angle at which the
other two are undefined.
"""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput
from motiongen_client.kinematics import Array, quaternion_to_matrix
from motiongen_client.motion import Motion, Rig
from motiongen_tools.whole_file import whole_file

_END_SITE_M = 0.05  # how far a joint without children is drawn, in the direction of its bone


def write_bvh(path: Path | str, motion: Motion, *, units_per_metre: float = 100.0) -> None:
    """Write a motion. Raises InvalidInput if it has no frames, or contains numbers that are not finite."""
    if len(motion) == 0:
        raise InvalidInput("motion", "no frames", "one frame or more")
    if not np.isfinite(motion.rows).all():
        raise InvalidInput("motion", "numbers that are not finite", "finite numbers")
    rig = motion.rig
    angles = np.degrees(euler_zxy(quaternion_to_matrix(motion.joint_rotation_quat_wxyz.astype(np.float64))))
    root = motion.root_translation_m.astype(np.float64) * units_per_metre
    order: list[int] = []
    with whole_file(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.write("HIERARCHY\n")
        _write_joint(file, rig, 0, 0, units_per_metre, order)
        file.write(f"MOTION\nFrames: {len(motion)}\nFrame Time: {1 / rig.frame_rate_hz:.8f}\n")
        channels = np.concatenate([root, angles[:, order].reshape(len(motion), -1)], axis=1)
        np.savetxt(file, channels, fmt="%.6f")


def euler_zxy(rotations: Array) -> NDArray[np.float64]:
    """(T, J, 3, 3) -> (T, J, 3) radians z, x, y with R = Rz Rx Ry, without jumps of a full turn along T.

    Where x is +-90 degrees, only the sum or difference of the other two is defined; y is then 0.
    """
    matrix = np.asarray(rotations, dtype=np.float64)
    sine_x = np.clip(matrix[..., 2, 1], -1, 1)
    x = np.arcsin(sine_x)
    locked = np.abs(sine_x) > 1 - 1e-10
    z_free = np.arctan2(-matrix[..., 0, 1], matrix[..., 1, 1])
    z_locked = np.arctan2(matrix[..., 1, 0], matrix[..., 0, 0])
    z = np.where(locked, z_locked, z_free)
    y = np.where(locked, 0.0, np.arctan2(-matrix[..., 2, 0], matrix[..., 2, 2]))
    return np.unwrap(np.stack([z, x, y], axis=-1), axis=0)


def _write_joint(file: TextIO, rig: Rig, joint: int, depth: int, scale: float, order: list[int]) -> None:
    """Write a joint and its descendants. Appends them to `order` in the order of their channels in a frame."""
    indent = "\t" * depth
    offset = rig.offsets_m[joint].astype(np.float64) * scale
    order.append(joint)
    file.write(f"{indent}{'JOINT' if depth else 'ROOT'} {rig.joint_names[joint]}\n{indent}{{\n")
    file.write(f"{indent}\tOFFSET {_triple(offset)}\n")
    position = "" if depth else "Xposition Yposition Zposition "
    file.write(f"{indent}\tCHANNELS {3 if depth else 6} {position}Zrotation Xrotation Yrotation\n")
    children = [child for child, parent in enumerate(rig.parents) if parent == joint]
    for child in children:
        _write_joint(file, rig, child, depth + 1, scale, order)
    if not children:
        length = float(np.linalg.norm(offset))
        direction = offset / length if length > 0 else np.array([0.0, 1.0, 0.0])
        end = direction * _END_SITE_M * scale
        file.write(f"{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {_triple(end)}\n{indent}\t}}\n")
    file.write(f"{indent}}}\n")


def _triple(values: NDArray[np.float64]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
