"""Poses: whole keyframes, hands, feet, the head's rotation, the root's height; joints and root separately."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets, limb_chains
from motiongen_ardy.core.rotation import rotation_vector, rotation_y
from motiongen_ardy.evaluate.cases import HISTORY, Case
from motiongen_ardy.evaluate.context import Context, Exhibit
from motiongen_ardy.evaluate.take import Result, Take

AHEAD_S = 1.5
HEAD_TURN_DEG = 45
LOWER_M = 0.10


def add(context: Context) -> None:
    """Add all rows about poses, which are the clip's own 1.5 s ahead; no head rotation without a head."""
    forms: dict[str, tuple[str, tuple[int, ...]]] = {"keyframe, body": ("keyframe", _all(context))}
    chains = limb_chains(context.skeleton)
    forms |= {
        "one hand": ("hand", chains["RightHand"][:1]),
        "one foot": ("foot", chains["LeftFoot"]),
        "both hands": ("hand", (chains["LeftHand"][0], chains["RightHand"][0])),
    }
    limbs = {"one hand": ["RightHand"], "one foot": ["LeftFoot"], "both hands": ["LeftHand", "RightHand"]}
    frame = HISTORY - 1 + context.frames(AHEAD_S)
    heads = ["head rotation"] if "Head" in context.skeleton.joint_names else []
    takes: dict[str, list[Take]] = {name: [] for name in (*forms, *heads, "root height")}
    for number, case in enumerate(context.both(frame + 1)):
        for name, group in takes.items():
            targets = Targets(context.skeleton)
            pose, turns = case.motion.positions[[frame]], case.motion.rotations[[frame]]
            if name == "keyframe, body":
                targets.add_keyframes([frame], pose)
            elif name in limbs:
                asked = [0, *(joint for limb in limbs[name] for joint in chains[limb])]
                first = [chains[limb][0] for limb in limbs[name]]
                targets.add_joints(frame, asked, pose[0, asked])
                targets.add_joints(frame, first, pose[0, first], turns[0, first])
            else:
                _ask(targets, name, frame, pose[0], turns[0], 1 if number % 2 else -1)
            for seed in context.seeds:
                group.append(_take(case, name, seed, frame, targets))
    results = iter(context.run([take for group in takes.values() for take in group]))
    for name, group in takes.items():
        done = [next(results) for _ in group]
        if name in forms:
            bound, joints = forms[name]
            context.add_goal("pose", f"{name}: joints", "m", done, _joints(frame, joints), bound=bound)
            context.add_goal("pose", f"{name}: root", "m", done, _root(frame))
        elif name == "head rotation":
            head = context.skeleton.index("Head")
            context.add_goal(
                "pose", f"{name}, turned {HEAD_TURN_DEG}", "degrees", done, _turn(frame, head), bound="head"
            )
        else:
            context.add_goal("pose", f"{name}, {LOWER_M * 100:g} cm lower", "m", done, _height(frame), bound="keyframe")
        title = f"{name} at frame {frame}"
        context.show("pose", [Exhibit(title, result) for result in (*done[:1], *done[-1:])])


def _all(context: Context) -> tuple[int, ...]:
    return tuple(range(1, context.skeleton.num_joints))


def _take(case: Case, name: str, seed: int, frame: int, targets: Targets) -> Take:
    end = frame + 1 + 9
    return Take(f"{case.id} {name}", seed, end, ((0, case.caption),), case.group, case.history, targets)


def _ask(targets: Targets, name: str, frame: int, pose: Tensor, turns: Tensor, side: int) -> None:
    """Constrain the clip's root, and its head turned aside; or only the root, lowered."""
    if name == "head rotation":
        head = targets.skeleton.index("Head")
        aside = rotation_y(torch.tensor(math.radians(side * HEAD_TURN_DEG))) @ turns[head]
        targets.add_joints(frame, [0, head], pose[[0, head]])
        targets.add_joints(frame, [head], pose[[head]], aside[None])
    else:
        targets.add_joints(frame, [0], pose[:1] - torch.tensor([0.0, LOWER_M, 0.0]))


def _joints(frame: int, joints: tuple[int, ...]) -> Callable[[Result], float]:
    """A measure of the mean distance of joints, after moving the root to the ground position that was asked for."""

    def measure(result: Result) -> float:
        asked, done = _asked(result, frame, joints), result.positions[frame]
        shift = (_ground(result, frame) - done[0]) * torch.tensor([1.0, 0.0, 1.0])
        return float((done[list(joints)] + shift - asked).norm(dim=-1).mean())

    return measure


def _ground(result: Result, frame: int) -> Tensor:
    assert result.take.targets is not None
    x, z = result.take.targets.ground[frame]
    return torch.tensor([x, 0.0, z])


def _asked(result: Result, frame: int, joints: tuple[int, ...]) -> Tensor:
    assert result.take.targets is not None
    return torch.from_numpy(np.array([result.take.targets.positions[frame, joint] for joint in joints]))


def _root(frame: int) -> Callable[[Result], float]:
    def measure(result: Result) -> float:
        return float((result.positions[frame, 0] - _ground(result, frame))[[0, 2]].norm())

    return measure


def _height(frame: int) -> Callable[[Result], float]:
    def measure(result: Result) -> float:
        assert result.take.targets is not None
        return abs(float(result.positions[frame, 0, 1] - result.take.targets.height[frame]))

    return measure


def _turn(frame: int, joint: int) -> Callable[[Result], float]:
    def measure(result: Result) -> float:
        assert result.take.targets is not None
        asked = torch.from_numpy(result.take.targets.rotations[frame, joint])
        return math.degrees(float(rotation_vector(asked.T @ result.rotations[frame, joint]).norm()))

    return measure
