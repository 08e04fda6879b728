"""All motion file formats, by suffix: which can be read, and which written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.formats.arrays import array_names
from motiongen_ardy.formats.bvh import read_bvh, write_bvh
from motiongen_ardy.formats.client_npz import MARK as CLIENT_MARK
from motiongen_ardy.formats.client_npz import read_client_npz
from motiongen_ardy.formats.errors import FormatError
from motiongen_ardy.formats.g1_csv import (
    QPOS_FPS,
    read_controller_csv,
    read_qpos_csv,
    write_controller_csv,
    write_qpos_csv,
)
from motiongen_ardy.formats.gltf import write_glb
from motiongen_ardy.formats.npz import read_npz, write_npz
from motiongen_ardy.formats.stored import StoredMotion
from motiongen_ardy.robot.g1 import load_g1


@dataclass(frozen=True)
class ReadOptions:
    """What a file may leave open. skeleton: which one, if several would fit; fps: of files without a clock."""

    skeleton: Skeleton | None = None
    fps: float = QPOS_FPS


@dataclass(frozen=True)
class MotionFormat:
    """One file format. write returns lines about what was changed or lost; rate_hz: for formats that resample."""

    name: str
    suffix: str
    about: str
    read: Callable[[Path, ReadOptions], StoredMotion] | None
    write: Callable[[Path, StoredMotion, float | None], tuple[str, ...]]


def _read_npz(path: Path, options: ReadOptions) -> StoredMotion:
    read = read_client_npz if CLIENT_MARK in array_names(path) else read_npz
    return read(path, options.skeleton)


def _read_qpos(path: Path, options: ReadOptions) -> StoredMotion:
    _check_robot(path, options)
    return read_qpos_csv(path, options.fps)


def _read_controller(path: Path, options: ReadOptions) -> StoredMotion:
    _check_robot(path, options)
    return read_controller_csv(path)


def _check_robot(path: Path, options: ReadOptions) -> None:
    robot = load_g1().skeleton
    if options.skeleton is not None and options.skeleton.joint_names != robot.joint_names:
        given = f"the skeleton {options.skeleton.name} for a file of the robot G1"
        raise FormatError(path, given, f"its skeleton is {robot.name}; leave it out")


def _npz(path: Path, stored: StoredMotion, rate_hz: float | None) -> tuple[str, ...]:
    write_npz(path, stored)
    return ()


def _bvh(path: Path, stored: StoredMotion, rate_hz: float | None) -> tuple[str, ...]:
    write_bvh(path, stored)
    return ()


def _glb(path: Path, stored: StoredMotion, rate_hz: float | None) -> tuple[str, ...]:
    write_glb(path, stored)
    return ()


def _qpos(path: Path, stored: StoredMotion, rate_hz: float | None) -> tuple[str, ...]:
    return write_qpos_csv(path, stored).lines


def _controller(path: Path, stored: StoredMotion, rate_hz: float | None) -> tuple[str, ...]:
    return write_controller_csv(path, stored, rate_hz).lines


# Longer suffixes first: the first match is used.
MOTION_FORMATS = (
    MotionFormat(
        "g1-controller-csv", ".controller.csv", "G1: a clock, qpos within limits, velocities; any rate",
        _read_controller, _controller,
    ),
    MotionFormat("g1-csv", ".csv", "G1: ARDY's 36 columns of qpos", _read_qpos, _qpos),
    MotionFormat("npz", ".npz", "ARDY's arrays; those of the Python client are read too", _read_npz, _npz),
    MotionFormat("bvh", ".bvh", "BVH in centimetres", lambda path, options: read_bvh(path, options.skeleton), _bvh),
    MotionFormat("gltf", ".glb", "binary glTF, skeleton, body and animation", None, _glb),
)  # fmt: skip


_PICKLES = (".pkl", ".pickle", ".pt", ".pth")


def format_of(path: Path, name: str | None = None) -> MotionFormat:
    """The format called `name`, or else the one of the path's suffix. Raises FormatError, which lists the formats."""
    for candidate in MOTION_FORMATS:
        if candidate.name == name or (name is None and path.name.lower().endswith(candidate.suffix)):
            return candidate
    if name is None and path.suffix.lower() in _PICKLES:
        raise FormatError(
            path, "a Python pickle, which can run any code", "export the motion to NPZ or BVH where it is from"
        )
    known = ", ".join(f"{one.name} (*{one.suffix})" for one in MOTION_FORMATS)
    raise FormatError(path, f"no format {name!r}" if name else "the name tells no format", f"the formats are {known}")


def sample_paths(path: Path, num_samples: int) -> list[Path]:
    """The paths of several samples, as in ARDY's command line: walk.npz for one, else walk/walk_00.npz and so on."""
    if num_samples == 1:
        return [path]
    suffix = path.name[-len(format_of(path).suffix) :]
    stem = path.name.removesuffix(suffix)
    return [path.parent / stem / f"{stem}_{index:02d}{suffix}" for index in range(num_samples)]


def read_motion(path: Path, options: ReadOptions | None = None, name: str | None = None) -> StoredMotion:
    """Read any motion file. Raises FormatError, and OSError as `open` does."""
    chosen = format_of(path, name)
    if chosen.read is None:
        readable = ", ".join(one.name for one in MOTION_FORMATS if one.read is not None)
        raise FormatError(path, f"{chosen.name} is only written", f"the formats that are read are {readable}")
    return chosen.read(path, options or ReadOptions())


def write_motion(
    path: Path, stored: StoredMotion, rate_hz: float | None = None, name: str | None = None
) -> tuple[str, ...]:
    """Write any motion file; returns lines that say what the format could not keep or had to change.

    rate_hz: rows a second of g1-controller-csv; None: the motion's own. Other formats keep the motion's frames.
    """
    return format_of(path, name).write(path, stored, rate_hz)
