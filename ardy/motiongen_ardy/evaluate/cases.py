"""The captured clips that takes continue, moving and standing ones separately, and the captures' own figures."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.data.dataset import Clip, DatasetError, MotionDataset
from motiongen_ardy.evaluate.measures.feet import slowest_foot
from motiongen_ardy.evaluate.measures.root import is_moving, is_running
from motiongen_ardy.evaluate.measures.smooth import accelerations, differences
from motiongen_ardy.evaluate.sampler import result_of
from motiongen_ardy.evaluate.take import Result, Take

HISTORY = 16
MOVING, STANDING = "moving", "standing"


@dataclass(frozen=True)
class Case:
    """A clip, moved so that its root is over the origin at its last history frame.

    features: (T, D) in natural units; the first HISTORY frames are the start of a take.
    changes: (frame, content before, content after) at which the action changes.
    """

    id: str
    content: str
    style: str
    caption: str
    group: str
    derived: bool
    motion: Result
    changes: tuple[tuple[int, str, str], ...] = ()

    @property
    def features(self) -> Tensor:
        return self.motion.features

    @property
    def num_frames(self) -> int:
        return len(self.features)

    @property
    def label(self) -> str:
        """Equal for cases whose captions mean the same."""
        return f"{self.content}/{self.style}"

    @property
    def history(self) -> Tensor:
        return self.features[:HISTORY]


@dataclass(frozen=True)
class Pace:
    """Figures of captures. feet: slowest foot over root speed; acceleration: p99 over joints and frames, m/s2."""

    feet: float
    acceleration: float


@dataclass(frozen=True)
class Captured:
    """Figures of moving captures; runs have their own, because runners are in the air between steps.

    walking: feet of those that do not run, accelerations of all.
    jumps: (3), p99 of the largest jump of any joint between frames, in position, velocity and acceleration.
    """

    walking: Pace
    running: Pace
    jumps: Tensor


def load_cases(dataset: MotionDataset, layout: Representation) -> list[Case]:
    """A case for every clip longer than its history, in an order independent of content and name.

    Raises DatasetError if there is none.
    """
    cases = [_case(clip, layout) for clip in dataset.clips if clip.num_frames > HISTORY + 4]
    if not cases:
        raise DatasetError(
            f"no clip of this split is longer than {HISTORY + 4} frames, so that no motion goes on from it"
        )
    return sorted(cases, key=lambda case: hashlib.sha1(case.id.encode()).hexdigest())


def _case(clip: Clip, layout: Representation) -> Case:
    local = quaternion_to_matrix(clip.local_rotations)
    features = layout.features(local[None], clip.root_positions[None])
    features = layout.translate_ground(features, -features[:, HISTORY - 1, [0, 2]])[0]
    group = MOVING if is_moving(features[:, [0, 2]], layout.fps) else STANDING
    take = Take(clip.id, 0, len(features), ((0, clip.captions[0]),), group)
    motion = result_of(layout, take, features)
    changes = tuple(
        (after.start, before.content, after.content)
        for before, after in pairwise(clip.segments)
        if before.start + before.length == after.start
    )
    return Case(clip.id, clip.content, clip.style, clip.captions[0], group, bool(clip.derived_from), motion, changes)


def captured_figures(cases: list[Case], layout: Representation) -> Captured:
    """The figures of moving captured clips, or of all clips if there are none; the same for running if none runs."""
    chosen = [case for case in cases if case.group == MOVING and not case.derived] or cases
    runs = [case for case in chosen if is_running(case.motion.root, layout.fps)]
    jumps = torch.cat([differences(case.motion.positions, layout.fps) for case in chosen]).numpy()
    return Captured(
        Pace(_feet([case for case in chosen if case not in runs] or chosen, layout), _acceleration(chosen, layout)),
        Pace(_feet(runs or chosen, layout), _acceleration(runs or chosen, layout)),
        torch.from_numpy(np.quantile(jumps, 0.99, axis=0)),
    )


def _feet(cases: list[Case], layout: Representation) -> float:
    feet = [slowest_foot(layout.skeleton, case.motion.positions, layout.fps) for case in cases]
    known = [value for value in feet if not math.isnan(value)]
    return float(np.mean(known)) if known else math.nan


def _acceleration(cases: list[Case], layout: Representation) -> float:
    steps = torch.cat([accelerations(case.motion.positions, layout.fps).flatten() for case in cases])
    return float(np.quantile(steps.numpy(), 0.99))
