"""Vectors by which the clients in Python and C++ are held equal: `python -m tests.client.golden_vectors` writes them.

A file of lines, each a name and numbers (or bytes in hex); `->` begins what comes of it. Made by the Python client;
tests/client/test_golden_vectors.py and client/cpp/tests/core compare both clients with what the files say.
"""

from __future__ import annotations

import math
import random
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np

from motiongen.v1 import motion_pb2
from motiongen_client import GODOT, ROS, UNITY, UNREAL, camera_relative, drawn_corners, stick_velocity
from motiongen_client.convert import FrameReader
from motiongen_client.convert.frames import SCALAR_TYPES
from motiongen_client.kinematics import matrix_to_quaternion
from motiongen_client.motion import CONTACT_BLOCK, ROOT_BLOCK, ROTATION_BLOCK, Float32, Motion, Rig
from motiongen_client.playback import Playback
from motiongen_client.retarget import JointMap, Retargeter, UserSkeleton
from motiongen_client.sampling import Sampler
from motiongen_client.types import FrameFormat
from tests.client.golden_ground import ground

FOLDER = Path(__file__).resolve().parents[1] / "data" / "client"
RATE_HZ = 20
JOINTS = 3
RIG = Rig(
    "chain",
    ("root", "middle", "end"),
    (-1, 0, 1),
    np.array([[0, 0, 0], [0, 1, 0], [0, 1, 0]], np.float32),
    RATE_HZ,
    {ROOT_BLOCK: 3, ROTATION_BLOCK: 4 * JOINTS, CONTACT_BLOCK: 4},
)

OUTPUTS = {"joint_positions_m": 9, "joint_global_rotation_quat_wxyz": 12, "joint_velocities_mps": 9}
ROBOT = {"g1_qpos": 36}  # not in QUANTISED


def numbers(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.7g}" for value in np.asarray(values, np.float64).ravel())


def drawn_rotations(draw: random.Random, count: int) -> Float32:
    """(count, 4) unit quaternions, of both signs."""
    values = np.array([[draw.gauss(0, 1) for _ in range(4)] for _ in range(count)])
    return (values / np.linalg.norm(values, axis=1, keepdims=True)).astype(np.float32)


def drawn_rows(draw: random.Random, count: int) -> Float32:
    """(count, D) of a chain that is turned anew at each frame: nothing of it is near anything else."""
    rows = np.zeros((count, RIG.row_width), np.float32)
    for row in rows:
        row[:3] = [draw.uniform(-5, 5) for _ in range(3)]
        row[3:15] = drawn_rotations(draw, JOINTS).ravel()
        row[15:] = [draw.randint(0, 1) for _ in range(4)]
    return np.array([[float(f"{value:.6g}") for value in row] for row in rows], np.float32)


# ---- poses between frames


class Script:
    """A session as it might go: replans, waits, cuts, pauses, another pace; and what is shown all along."""

    def __init__(self, seed: int) -> None:
        self.draw = random.Random(seed)
        self.now_s = 0.0
        self.plan = 0
        self.received = 0

    def lines(self) -> Iterator[str]:
        yield f"begin {RATE_HZ}"
        for _ in range(60):
            match self.draw.choices(("plan", "chunk", "pause", "resume", "scale", "wait"), (2, 5, 1, 1, 1, 10))[0]:
                case "plan":
                    yield self.new_plan()
                case "chunk" if self.plan:
                    count = self.draw.randint(1, 6)
                    rows = drawn_rows(self.draw, count)
                    yield f"chunk {self.plan} {self.received} {count} {numbers(rows)}"
                    self.received += count
                case "scale":
                    yield f"scale {self.draw.choice([0.5, 1, 1, 2])}"
                case "pause" | "resume" as name:
                    yield name
                case _:
                    for _ in range(self.draw.randint(1, 4)):
                        self.now_s += self.draw.choice([1 / 60, 1 / 144, 0.0317])
                        yield f"sample {self.now_s:.9f}"

    def new_plan(self) -> str:
        self.plan += 1
        back = self.draw.randint(0, 4) if self.draw.random() < 0.7 else 0
        self.received = max(self.received - back, 0)
        return f"plan {self.plan} {self.received} {int(self.draw.random() < 0.2)}"


class Player:
    """The Python client, told the lines of a script."""

    def __init__(self) -> None:
        self.playback = Playback(RATE_HZ, RIG.row_width)
        self.sampler = Sampler(RIG, self.playback)

    def tell(self, line: str) -> str:
        """What comes of it: of `sample` the playhead and the row, or nothing before there is one."""
        name, *words = line.split()
        playback = self.playback
        match name:
            case "begin":
                self.__init__()  # type: ignore[misc]
            case "plan":
                playback.announce_plan(int(words[0]), int(words[1]), is_cut=words[2] == "1")
            case "chunk":
                plan, first, count = map(int, words[:3])
                rows = np.array(words[3:], np.float32).reshape(count, RIG.row_width)
                playback.add_chunk(plan, first, rows, 0)
            case "pause":
                playback.pause()
            case "resume":
                playback.resume()
            case "scale":
                playback.set_time_scale(float(words[0]))
            case "sample":
                playback.advance(float(words[0]))
                if not playback.started:
                    return "-1"
                _, row = self.sampler.row(float(words[0]))
                return f"{playback.playhead} {numbers(row)}"
        return ""


def sampling() -> Iterator[str]:
    for seed in range(5):
        player = Player()
        for line in Script(seed).lines():
            yield f"{line} -> {player.tell(line)}".rstrip()


# ---- axes, steering, formats


def axes() -> Iterator[str]:
    draw = random.Random(1)
    for engine in (UNREAL, UNITY, GODOT, ROS):
        for _ in range(4):
            place = [draw.uniform(-10, 10) for _ in range(3)]
            turn = drawn_rotations(draw, 1)[0]
            moved = (*engine.positions(place), *engine.quaternions_xyzw(turn))
            yield f"{engine.name} {numbers(place)} {numbers(turn)} -> {numbers(moved)}"


def steering() -> Iterator[str]:
    draw = random.Random(2)
    for _ in range(16):
        right, forward = draw.uniform(-1, 1), draw.uniform(-1, 1)
        camera, speed, dead_zone = draw.uniform(-4, 4), draw.uniform(0.5, 4), draw.choice([0, 0.15, 0.6])
        found = stick_velocity(right, forward, camera_heading_rad=camera, speed_mps=speed, dead_zone=dead_zone)
        yield f"stick {numbers((right, forward, camera, speed, dead_zone))} -> {numbers(found)}"
        yield f"camera {numbers((right, forward, camera))} -> {numbers(camera_relative(right, forward, camera))}"
    for count, within_m in ((1, 0.1), (2, 0.1), (40, 0.1), (40, 0.5), (600, 0.01)):
        points = np.cumsum([[draw.gauss(0, 0.2), draw.gauss(0, 0.2)] for _ in range(count)], axis=0)
        points = np.array([[float(f"{value:.5g}") for value in point] for point in points])
        corners = drawn_corners(points, within_m=within_m)
        yield f"corners {within_m} {numbers(points)} -> {numbers(corners)}"


def packed(turn: Float32) -> int:
    """A rotation as QUANTISED stores it: which is the greatest, and ten bits of each of the others."""
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
    """Rows with what a session asks for besides, near their roots."""
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
    """A chunk's data in F16: places are seen from the first root."""
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


BODY = UserSkeleton(
    ("base", "mid", "tip", "tail"),
    (-1, 0, 1, 0),
    [[0, 0, 0], [60, 10, 0], [55, 0, -5], [0, -20, 4]],
    [[1, 0, 0, 0], [0.8, 0, 0.6, 0], [1, 0, 0, 0], [0.96, 0, 0, 0.28]],
)
MAP = {
    "metres_per_unit": 0.01,
    "joints": {
        "root": {"from": "base", "axes": ["up", "right", "forward"]},
        "end": {"from": "tip", "axes": ["up", "forward", "left"], "turn": {"about": "left", "degrees": 25}},
    },
    "follow": {"mid": {"between": ["root", "middle"], "fraction": 0.4, "axes": ["up", "right", "forward"]}},
    "root": {
        "from": ["base"],
        "to": ["root", "middle"],
        "scale": 1.25,
        "ground": {"source_height": 11.0, "height": 0.07},
    },
}
BY_LENGTH = {
    "scale": {"from": [["base", "mid", "tip"]], "to": [["root", "middle", "end"]]},
    "ground": {"lowest_of": ["end"], "height": 0.07},
}


def described(joint_map: JointMap) -> Iterator[str]:
    """A map as the C++ client takes it."""
    rest = BODY.rest
    for joint, name in enumerate(BODY.joint_names):
        yield f"joint {name} {BODY.parents[joint]} {numbers(BODY.offsets[joint])} {numbers(rest[joint])}"
    on_feet = joint_map.ground_theirs is None
    ground = (joint_map.ground_theirs or 0.0, joint_map.ground_ours_m)
    yield f"map {joint_map.metres_per_unit} {joint_map.scale or 0} {int(on_feet)} {numbers(ground)}"
    for theirs, drive in joint_map.drives.items():
        axes = numbers(matrix_to_quaternion(drive.axes))
        yield f"drive {theirs} {drive.ours[0]} {drive.ours[1]} {drive.fraction} {axes}"
    chains_theirs, chains_ours = joint_map.leg_chains
    lists = {"root_theirs": joint_map.root_theirs, "root_ours": joint_map.root_ours, "feet": joint_map.feet_ours}
    for name, names in (*lists.items(), *(("chain_theirs", chain) for chain in chains_theirs)):
        yield " ".join((name, *names))
    for chain in chains_ours:
        yield " ".join(("chain_ours", *chain))


def retarget() -> Iterator[str]:
    draw = random.Random(4)
    for root in (MAP["root"], {**MAP["root"], **BY_LENGTH}):  # type: ignore[dict-item]
        joint_map = JointMap.of({**MAP, "root": root})
        yield from described(joint_map)
        retargeter = Retargeter(RIG, joint_map, BODY)
        yield f"begin -> {retargeter.scale:.7g}"
        before = np.tile([1.0, 0.0, 0.0, 0.0], (len(BODY.joint_names), 1))
        for row in drawn_rows(draw, 6):
            made = retargeter.apply(Motion(RIG, 0, row[None]), before)
            before = made.joint_rotation_quat_wxyz[0]
            yield f"frame {numbers(row)} -> {numbers(made.root_translation[0])} {numbers(before)}"


FILES: dict[str, Callable[[], Iterator[str]]] = {
    "sampling": sampling,
    "axes": axes,
    "steering": steering,
    "frame_formats": frame_formats,
    "retarget": retarget,
    "ground": ground,
}


def main() -> int:
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, lines in FILES.items():
        (FOLDER / f"{name}.txt").write_text("\n".join(lines()) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
