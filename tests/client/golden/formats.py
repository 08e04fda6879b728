"""Golden vectors of frames as they are sent: in F16 and QUANTISED, with outputs and without."""

from __future__ import annotations

import math
import random
from collections.abc import Iterator

import numpy as np

from motiongen.v1 import motion_pb2
from motiongen_client.convert import FrameReader
from motiongen_client.convert.frames import SCALAR_TYPES
from motiongen_client.motion import Float32, Rig
from motiongen_client.types import FrameFormat
from tests.client.golden.draws import RIG, drawn_rotations, drawn_rows, numbers

OUTPUTS = {"joint_positions_m": 9, "joint_global_rotation_quat_wxyz": 12, "joint_velocities_mps": 9}
ROBOT = {"g1_qpos": 36}  # not in QUANTISED


def packed(turn: Float32) -> int:
    """A rotation as QUANTISED stores it: the index of the largest component, and ten bits of each of the others."""
    greatest = int(np.abs(turn).argmax())
    turn = turn if turn[greatest] > 0 else -turn
    word = greatest << 30
    shift = 20
    for place in range(4):
        if place != greatest:
            word |= round(511.5 + 511 * math.sqrt(2) * float(turn[place])) << shift
            shift -= 10
    return word


def drawn_outputs(draw: random.Random, rig: Rig, rows: Float32) -> Float32:
    """Rows with the outputs that a session asks for, placed near their roots."""
    parts = [rows]
    for name, width in rig.outputs.items():
        if name == "joint_global_rotation_quat_wxyz":
            parts.append(np.array([drawn_rotations(draw, width // 4).ravel() for _ in rows]))
            continue
        values = np.array([[draw.uniform(-2, 2) for _ in range(width)] for _ in rows])
        if name == "joint_positions_m":
            values += np.tile(rows[:, :3], width // 3)
        parts.append(values)
    return np.concatenate(parts, axis=1).astype(np.float32)


def halves(rows: Float32, rig: Rig) -> bytes:
    """A chunk's data in F16: places are relative to the first root."""
    seen, origin = rows.copy(), rows[0, :3]
    seen[:, :3] -= origin
    if "joint_positions_m" in rig.outputs:
        seen[:, rig.columns("joint_positions_m")] -= np.tile(origin, 3)
    if "g1_qpos" in rig.outputs:
        start = rig.columns("g1_qpos").start
        seen[:, start : start + 3] -= origin[[2, 0, 1]]
    return seen.astype("<f2").tobytes()


def quantised(rows: Float32, rig: Rig) -> bytes:
    """A chunk's data in QUANTISED."""
    data = b""
    for row in rows:
        data += np.round(1000 * row[:3]).astype("<i4").tobytes()
        data += np.array([packed(turn) for turn in row[3:15].reshape(-1, 4)], "<u4").tobytes()
        data += bytes([sum(int(on) << foot for foot, on in enumerate(row[15:19]))])
        for name in rig.outputs:
            values = row[rig.columns(name)]
            if name == "joint_global_rotation_quat_wxyz":
                data += np.array([packed(turn) for turn in values.reshape(-1, 4)], "<u4").tobytes()
                continue
            places = np.tile(row[:3], 3) if name == "joint_positions_m" else np.zeros(len(values))
            data += np.round(1000 * (values - places)).astype("<i2").tobytes()
    return data


def frame_formats() -> Iterator[str]:
    draw = random.Random(3)
    for frame_format, outputs in (
        (FrameFormat.F16, {}),
        (FrameFormat.QUANTISED, {}),
        (FrameFormat.F16, OUTPUTS | ROBOT),
        (FrameFormat.QUANTISED, OUTPUTS),
    ):
        rig = RIG.with_outputs(outputs)
        reader, before = FrameReader(rig, frame_format), None
        for _ in range(3 if outputs else 6):
            rows = drawn_outputs(draw, rig, drawn_rows(draw, draw.randint(1, 4)))
            is_half = frame_format is FrameFormat.F16
            origin = rows[0, :3].tolist() if is_half else []
            data = halves(rows, rig) if is_half else quantised(rows, rig)
            chunk = motion_pb2.FrameChunk(
                frame_count=len(rows), data=data, scalar_type=SCALAR_TYPES[frame_format], root_origin_m=origin
            )
            read = reader.rows(chunk, before)
            before = read[-1]
            name = frame_format.value + ("_outputs" if outputs else "")
            yield f"{name} {len(rows)} {data.hex()} {numbers(origin)}".rstrip() + f" -> {numbers(read)}"
