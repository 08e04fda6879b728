"""Which features of a training window are told to the denoiser, drawn from the paper's common use cases.

2D root waypoints and trajectories, sparse full-body keyframes and blocks of them, sparse end-effector keyframes, and
foot keyframes where the foot is planted; inside the horizon and beyond it. The columns a constraint covers are those
that `motiongen_ardy.constraint` fills for the same constraint at run time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_ardy.representation import Representation

BoolArray = np.ndarray


@dataclass(frozen=True)
class ConstraintChances:
    """How often each kind is drawn; `none` is drawn first, then one or two of the others."""

    none: float = 0.3
    second_kind: float = 0.25
    waypoints: float = 0.3
    trajectory: float = 0.25
    keyframes: float = 0.15
    keyframe_block: float = 0.05
    end_effectors: float = 0.17
    planted_feet: float = 0.08


class ConstraintSampler:
    """Draws feature masks (T, D) for windows of one representation."""

    def __init__(self, representation: Representation, chances: ConstraintChances | None = None) -> None:
        self.representation = representation
        self.chances = chances or ConstraintChances()
        skeleton = representation.skeleton
        self.ground = self._columns([0, 2])
        self.heading = self._columns(range(3, 5))
        self.pose_root = self._columns([0, 1, 2, 3, 4])
        position = representation.position_block
        self.full_body = self._columns(range(position.start, position.stop))
        self.limbs = [
            self._limb(chain)
            for chain in (skeleton.left_hand, skeleton.right_hand, skeleton.left_foot, skeleton.right_foot)
        ]

    def _columns(self, columns: range | list[int]) -> BoolArray:
        mask = np.zeros(self.representation.feature_dim, dtype=bool)
        mask[list(columns)] = True
        return mask

    def _limb(self, chain: tuple[int, ...]) -> BoolArray:
        """Positions of the chain's joints, rotations of its first joint and of the root."""
        position, rotation = self.representation.position_block.start, self.representation.rotation_block.start
        columns = [position + 3 * (joint - 1) + axis for joint in chain for axis in range(3)]
        columns += [rotation + 6 * joint + number for joint in (0, chain[0]) for number in range(6)]
        return self._columns(columns)

    def sample(
        self, random: np.random.Generator, first: int, horizon_end: int, end: int, planted: BoolArray
    ) -> BoolArray:
        """A mask (end, D) that is true only at frames first..end-1.

        first: the first generated frame; horizon_end: one past the last; end: one past the last known frame.
        planted: (end, 2) bool, whether the left and right heel are in contact.
        """
        mask = np.zeros((end, self.representation.feature_dim), dtype=bool)
        if random.random() < self.chances.none or end <= first:
            return mask
        kinds = [self._waypoints, self._trajectory, self._keyframes, self._keyframe_block, self._end_effectors]
        weights = np.array(
            [
                self.chances.waypoints,
                self.chances.trajectory,
                self.chances.keyframes,
                self.chances.keyframe_block,
                self.chances.end_effectors,
                self.chances.planted_feet,
            ]
        )
        count = 2 if random.random() < self.chances.second_kind else 1
        # Half of the goals lie inside the horizon; the others anywhere, so that distant goals are seen too.
        limit = horizon_end if random.random() < 0.5 else end
        for kind in random.choice(len(weights), size=count, replace=False, p=weights / weights.sum()):
            if kind < len(kinds):
                kinds[kind](random, mask, first, limit)
            else:
                self._planted_feet(random, mask, first, limit, planted)
        return mask

    @staticmethod
    def _frames(random: np.random.Generator, first: int, end: int, most: int) -> np.ndarray:
        count = min(end - first, int(random.integers(1, most + 1)))
        return np.asarray(first + random.choice(end - first, size=count, replace=False))

    def _ground_columns(self, random: np.random.Generator) -> BoolArray:
        return self.ground | self.heading if random.random() < 0.5 else self.ground

    def _waypoints(self, random: np.random.Generator, mask: BoolArray, first: int, end: int) -> None:
        mask[self._frames(random, first, end, 3)] |= self._ground_columns(random)

    def _trajectory(self, random: np.random.Generator, mask: BoolArray, first: int, end: int) -> None:
        columns = self._ground_columns(random)
        if random.random() < 0.5:
            mask[first:end] |= columns
            return
        start = int(random.integers(first, end))
        stop = int(random.integers(start + 1, end + 1))
        stride = 1 if random.random() < 0.6 else 10  # every tenth frame is what velocity control asks for
        mask[start:stop:stride] |= columns

    def _keyframes(self, random: np.random.Generator, mask: BoolArray, first: int, end: int) -> None:
        mask[self._frames(random, first, end, 3)] |= self.full_body | self.pose_root

    def _keyframe_block(self, random: np.random.Generator, mask: BoolArray, first: int, end: int) -> None:
        start = int(random.integers(first, end))
        mask[start : min(end, start + int(random.integers(4, 17)))] |= self.full_body | self.pose_root

    def _end_effectors(self, random: np.random.Generator, mask: BoolArray, first: int, end: int) -> None:
        frames = self._frames(random, first, end, 4)
        for limb in random.choice(4, size=int(random.integers(1, 4)), replace=False):
            mask[frames] |= self.limbs[limb] | self.pose_root

    def _planted_feet(
        self, random: np.random.Generator, mask: BoolArray, first: int, end: int, planted: BoolArray
    ) -> None:
        for side, limb in enumerate((2, 3)):
            frames = first + np.flatnonzero(planted[first:end, side])
            if len(frames):
                chosen = random.choice(frames, size=min(len(frames), int(random.integers(1, 4))), replace=False)
                mask[chosen] |= self.limbs[limb] | self.pose_root
