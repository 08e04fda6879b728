"""The questions for every model: each of its presets, and a target of each kind. Times in seconds, places in metres."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from motiongen_client.motion import Float32, Rig
from motiongen_client.prompts import Preset, Prompt
from motiongen_client.types import (
    Constraint,
    HeadingTarget,
    JointTargets,
    Keyframe,
    Model,
    RootPath,
    RootTrajectory,
    Waypoint,
)

SECONDS = 4.0
STAND, WALK = "a person stands still", "a person walks forward"


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses that the model itself made, (J, 3) metres, at the origin: one standing, one in a gesture."""

    rig: Rig
    standing_m: Float32
    gesture_m: Float32

    def frame(self, seconds: float) -> int:
        return self.rig.frames_in(seconds)

    def limb(self, name: str, away_m: tuple[float, float, float]) -> tuple[int, Float32]:
        """The first joint of a limb, and a place that is away_m from where that joint is in the standing pose."""
        joint = self.rig.limbs[name][0]
        return joint, (self.standing_m[joint] + np.array(away_m, np.float32)).astype(np.float32)


@dataclass(frozen=True)
class Question:
    """A row of the gallery. targets: makes the constraints; None, which leaves the row out, if the rig lacks joints."""

    part: str
    title: str
    prompt: Prompt
    seconds: float = SECONDS
    later: Mapping[float, Prompt] = field(default_factory=dict)
    targets: Callable[[Poses], list[Constraint] | None] = lambda poses: []


def questions_of(model: Model) -> list[Question]:
    """All questions for a model."""
    told = model.preset_descriptions
    names = {name: f"{name}: {told[name]}" if told.get(name) else name for name in model.presets}
    asked = [Question("Presets", title, Preset(name)) for name, title in names.items()]
    return [*asked, *TARGETS, *CHANGES]


def _limb(name: str, away_m: tuple[float, float, float]) -> Callable[[Poses], list[Constraint] | None]:
    def targets(poses: Poses) -> list[Constraint] | None:
        if name not in poses.rig.limbs:
            return None
        joint, place = poses.limb(name, away_m)
        return [JointTargets(poses.frame(2), (joint,), place[None])]

    return targets


def _curve(poses: Poses) -> list[Constraint]:
    """An S of 3 m at about a metre a second, starting a metre ahead."""
    ahead = np.linspace(0, 3, poses.frame(3))
    places = np.stack([0.3 * np.sin(2 * math.pi * ahead / 3), 1 + ahead], axis=-1)
    return [RootTrajectory(poses.frame(1.5), places.astype(np.float32))]


def _lower(poses: Poses) -> list[Constraint]:
    root = poses.standing_m[0] - np.array([0.0, 0.1, 0.0], np.float32)
    return [JointTargets(poses.frame(2), (0,), root[None])]


TARGETS = [
    Question("Targets", "2 m ahead at 2 s, from standing", STAND, targets=lambda p: [Waypoint(p.frame(2), 0, 2)]),
    Question(
        "Targets", "aside at 2.5 s, from standing", STAND, targets=lambda p: [Waypoint(p.frame(2.5), 1.5, 1.5)]
    ),
    Question("Targets", "2 m behind at 3 s, from standing", STAND, targets=lambda p: [Waypoint(p.frame(3), 0, -2)]),
    Question(
        "Targets", "a place and a heading at 3 s, while walking", WALK,
        targets=lambda p: [Waypoint(p.frame(3), 1.2, 2.2, math.pi / 2)],
    ),
    Question("Targets", "a curve, a place a frame", WALK, 5.0, targets=_curve),
    Question(
        "Targets", "a path through corners", WALK, 6.0,
        targets=lambda p: [RootPath(np.array([[0, 2], [2, 2], [2, 4]], np.float32), 1.2)],
    ),
    Question(
        "Targets", "facing left at 2 s, while walking", WALK,
        targets=lambda p: [HeadingTarget(p.frame(2), math.pi / 2)],
    ),
    Question(
        "Targets", "a whole pose at 2 s, from standing", STAND, targets=lambda p: [Keyframe(p.frame(2), p.gesture_m)]
    ),
    Question("Targets", "the right hand ahead at 2 s", STAND, targets=_limb("RightHand", (0.0, 0.45, 0.35))),
    Question("Targets", "the left foot ahead at 2 s", STAND, targets=_limb("LeftFoot", (0.05, 0.1, 0.25))),
    Question("Targets", "the root 10 cm lower at 2 s", STAND, targets=_lower),
]  # fmt: skip

CHANGES = [
    Question("Changes of mind", "walks, from 2 s on stands", WALK, 5.0, {2.0: STAND}),
    Question("Changes of mind", "walks, from 2 s on runs", WALK, 5.0, {2.0: "a person runs forward"}),
    Question(
        "Changes of mind", "runs, from 2 s on turns left", "a person runs forward", 5.0,
        {2.0: "a person turns left while walking"},
    ),
    Question(
        "Changes of mind", "stands, from 2 s on waves", STAND, 5.0, {2.0: "a person waves with the right hand"}
    ),
]  # fmt: skip
