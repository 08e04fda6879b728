"""Golden vectors of frames on another skeleton."""

from __future__ import annotations

import random
from collections.abc import Iterator

import numpy as np

from motiongen_client.kinematics import matrix_to_quaternion
from motiongen_client.motion import Motion
from motiongen_client.retarget import JointMap, Retargeter, UserSkeleton
from tests.client.golden.draws import RIG, drawn_rows, numbers

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
    """A map in the form that the C++ client reads."""
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
