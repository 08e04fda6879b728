"""Motion as BVH, for animation tools, and back.

Lengths are in centimetres by default, angles in degrees. Every joint has the rotation channels Z, X, Y: the heading is
the last angle, so that turning round never reaches the angle at which the other two are undefined.
"""

from __future__ import annotations

from pathlib import Path
from typing import TextIO

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.files import written_whole
from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.bvh import Bvh, BvhError, parse_bvh
from motiongen_ardy.formats.bounded import check_num_frames, read_text
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.stored import StoredMotion, as_array, check_bones, from_pose, skeleton_with, whole_fps

BONES_WITHIN_M = 0.01
_UNITS_PER_METRE = (1.0, 100.0, 1000.0, 1 / 0.0254)  # metres, centimetres, millimetres, inches
_LOCKED = 1e-6  # radians from gimbal lock
_END_SITE_M = 0.05  # length of the end site of a last joint, in the direction of its bone


def write_bvh(path: Path, stored: StoredMotion, units_per_metre: float = 100.0) -> None:
    """Write a motion with any skeleton. Contacts and text cannot be stored in the file."""
    skeleton, motion = stored.skeleton, stored.motion
    angles = np.degrees(euler_zxy(as_array(motion.local_rotations)))
    root = as_array(motion.root_positions) * units_per_metre
    order: list[int] = []
    with written_whole(path) as partial, partial.open("w", encoding="utf-8", newline="\n") as file:
        file.write("HIERARCHY\n")
        _write_joint(file, skeleton, 0, 0, units_per_metre, order)
        file.write(f"MOTION\nFrames: {motion.num_frames}\nFrame Time: {1 / motion.fps:.8f}\n")
        np.savetxt(file, np.concatenate([root, angles[:, order].reshape(len(root), -1)], axis=1), fmt="%.6f")


def euler_zxy(rotations: np.ndarray) -> np.ndarray:
    """(T, ..., 3, 3) -> (T, ..., 3) radians z, x, y with R = Rz Rx Ry, without jumps of a full turn along T.

    At x = +-90 degrees, only the sum or difference of the others is defined; y is set to 0 there. Near it, z is
    ill-conditioned, so y is computed from what remains after removing z: together they reproduce the rotation exactly.
    """
    cosine = np.hypot(rotations[..., 2, 0], rotations[..., 2, 2])
    x = np.arctan2(rotations[..., 2, 1], cosine)
    locked = cosine < _LOCKED
    z_free = np.arctan2(-rotations[..., 0, 1], rotations[..., 1, 1])
    z = np.where(locked, np.arctan2(rotations[..., 1, 0], rotations[..., 0, 0]), z_free)
    across = np.cos(z)[..., None] * rotations[..., 0, :] + np.sin(z)[..., None] * rotations[..., 1, :]
    y = np.arctan2(across[..., 2], across[..., 0])
    angles: np.ndarray = np.unwrap(np.stack([z, x, y], axis=-1), axis=0)
    return angles


def _write_joint(file: TextIO, skeleton: Skeleton, joint: int, depth: int, scale: float, order: list[int]) -> None:
    """Write a joint and all below it; `order` collects the joints in the order of their channels in a frame."""
    indent = "\t" * depth
    order.append(joint)
    offset = skeleton.offsets[joint] * scale
    file.write(f"{indent}{'JOINT' if depth else 'ROOT'} {skeleton.joint_names[joint]}\n{indent}{{\n")
    file.write(f"{indent}\tOFFSET {_triple(offset)}\n")
    position = "" if depth else "Xposition Yposition Zposition "
    file.write(f"{indent}\tCHANNELS {3 if depth else 6} {position}Zrotation Xrotation Yrotation\n")
    children = [child for child, parent in enumerate(skeleton.parents) if parent == joint and child != joint]
    for child in children:
        _write_joint(file, skeleton, child, depth + 1, scale, order)
    if not children:
        length = float(np.linalg.norm(offset))
        direction = offset / length if length > 0 else np.array([0.0, 1.0, 0.0])
        end = direction * _END_SITE_M * scale
        file.write(f"{indent}\tEnd Site\n{indent}\t{{\n{indent}\t\tOFFSET {_triple(end)}\n{indent}\t}}\n")
    file.write(f"{indent}}}\n")


def _triple(values: np.ndarray) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def read_bvh(path: Path, skeleton: Skeleton | None = None) -> StoredMotion:
    """Read the motion of a BVH with one of our skeletons, recognised by its joints' names, in any order, and its bones.

    Any channel order and unit (metres, centimetres, millimetres, inches, inferred from the bones). Contacts are
    computed from the poses. Raises FormatError for other skeletons (`motiongen_ardy.data` retargets those), bones that
    change their length, frame rates that are not whole, and text that is not BVH.
    """
    try:
        bvh = parse_bvh(read_text(path), str(path))
    except BvhError as error:
        raise FormatError(path, f"line {error.line}: {error.problem}"[:300], "give a BVH file") from None
    check_num_frames(path, bvh.num_frames)
    fps = whole_fps(path, 1 / bvh.frame_time_s, f"a frame time of {bvh.frame_time_s:g} s")
    skeleton = skeleton_with(path, bvh.joint_names, skeleton)
    order = [bvh.joint_names.index(name) for name in skeleton.joint_names]
    _check_tree(path, bvh, skeleton, order)
    scale = _metres_per_unit(path, skeleton, bvh.offsets[order])
    rotations, translations = bvh.pose()
    rotations, translations = rotations[:, order], translations[:, order] * scale
    check_bones(path, skeleton, torch.from_numpy(bvh.offsets[order] * scale), BONES_WITHIN_M)
    _check_rigid(path, skeleton, translations)
    return from_pose(skeleton, rotations, translations[:, 0], fps, source=path)


def _check_tree(path: Path, bvh: Bvh, skeleton: Skeleton, order: list[int]) -> None:
    for joint, at in enumerate(order):
        above = bvh.joint_names[bvh.parents[at]] if bvh.parents[at] >= 0 else ""
        wanted = skeleton.joint_names[skeleton.parents[joint]] if joint else ""
        if above != wanted:
            given = f"{skeleton.joint_names[joint]} hangs on {above or 'nothing'}"
            raise FormatError(path, given, f"in {skeleton.name} it hangs on {wanted or 'nothing'}; retarget it first")


def _metres_per_unit(path: Path, skeleton: Skeleton, offsets: np.ndarray) -> float:
    """The unit in which the total length of the file's bones is that of the skeleton's."""
    with np.errstate(over="ignore"):  # an infinite length fits no unit either
        given = float(np.linalg.norm(offsets[1:], axis=1).sum())
    wanted = float(np.linalg.norm(skeleton.offsets[1:], axis=1).sum())
    closest = min(_UNITS_PER_METRE, key=lambda units: abs(np.log(max(given, 1e-12) / (wanted * units))))
    if not 0.8 < given / (wanted * closest) < 1.25:
        said = f"bones of {given:.4g} units in all, where {skeleton.name} has {wanted:.3g} m"
        raise FormatError(path, said, "no unit known here fits; retarget it first, see python -m motiongen_ardy.data")
    return 1 / closest


def _check_rigid(path: Path, skeleton: Skeleton, translations: Tensor) -> None:
    """Raise FormatError unless positions (T, J, 3) from channels of joints below the root stay on the bones."""
    error = (translations[:, 1:] - torch.tensor(skeleton.offsets[1:], device="cpu")).norm(dim=-1)
    if float(error.max()) > BONES_WITHIN_M:
        frame, joint = divmod(int(error.argmax()), error.shape[1])
        name = skeleton.joint_names[joint + 1]
        given = f"the bone of {name} is {100 * float(error.max()):.1f} cm longer, shorter or aside in frame {frame}"
        raise FormatError(path, given, "bones are rigid here; only the root may have position channels that move it")
