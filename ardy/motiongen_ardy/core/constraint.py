"""Constraints (waypoints, root trajectories, keyframes, end effectors) as observed features and a mask.

World units: metres, radians, global rotations. Velocities and contacts are never constrained.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from motiongen_ardy.core.constraint_values import (
    ConstraintError,
    Floats,
    require_frames,
    require_numbers,
    require_rotations,
)
from motiongen_ardy.core.representation import Representation, heading_angle
from motiongen_ardy.core.skeleton import Skeleton


def limb_chains(skeleton: Skeleton) -> Mapping[str, tuple[int, ...]]:
    """The joint chains that end-effector constraints can name, by name."""
    return {
        "LeftHand": skeleton.left_hand,
        "RightHand": skeleton.right_hand,
        "LeftFoot": skeleton.left_foot,
        "RightFoot": skeleton.right_foot,
        "Hips": (0,),
    }


def facings(angles: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
    """Cosine and sine (K, 2) of headings (K) in radians."""
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


class Targets:
    """Target values for features at frames, gathered from constraints; where two disagree, the later one wins.

    Frames are absolute and start at 0; `fill` and `observe` lay out any range of them. The groups are independent: a
    waypoint overrides the ground position of an earlier keyframe at the same frame, but not its pose. Values are
    stored, and may be given, as float32 arrays on the CPU: there are many small ones, and tensors are slower to create.

    ground: frame -> (2), x and z in metres; height: frame -> (), metres; heading: frame -> (2), cosine and sine.
    positions: (frame, joint) -> (3), metres; rotations: (frame, joint) -> (3, 3), global.
    own_roots: (frame, joint) -> (2), for a limb without its root: where the root is in the pose that the limb is from.
    planned, faced: frames whose ground position, or heading, was not asked for itself but leads to what was asked for;
    the root may sway about these.
    """

    def __init__(self, skeleton: Skeleton) -> None:
        self.skeleton = skeleton
        self.ground: dict[int, Floats] = {}
        self.height: dict[int, np.float32] = {}
        self.heading: dict[int, Floats] = {}
        self.positions: dict[tuple[int, int], Floats] = {}
        self.rotations: dict[tuple[int, int], Floats] = {}
        self.own_roots: dict[tuple[int, int], Floats] = {}
        self.planned: set[int] = set()
        self.faced: set[int] = set()

    @property
    def frames(self) -> set[int]:
        """Every frame that has a target."""
        jointwise = {frame for frame, _ in (*self.positions, *self.rotations)}
        return {*self.ground, *self.height, *self.heading, *jointwise}

    def add_waypoints(
        self, frames: Sequence[int], ground: Tensor | Floats, heading: Tensor | Floats | None = None
    ) -> None:
        """Add waypoints or a root trajectory. ground: (K, 2), x and z in metres; heading: (K) radians, or None."""
        frames = require_frames(frames)
        places = require_numbers("ground positions", ground, (len(frames), 2))
        angles = None if heading is None else require_numbers("headings", heading, (len(frames),))
        self.ground.update(zip(frames, places, strict=True))
        self.planned.difference_update(frames)
        if angles is not None:
            self.add_heading(frames, angles)

    def add_heading(self, frames: Sequence[int], heading: Tensor | Floats) -> None:
        """Constrain the heading alone. heading: (K) radians."""
        frames = require_frames(frames)
        angles = require_numbers("headings", heading, (len(frames),))
        self.heading.update(zip(frames, facings(angles), strict=True))
        self.faced.difference_update(frames)

    def add_lead(self, first_frame: int, ground: Tensor | Floats, heading: Tensor | Floats | None, stride: int) -> None:
        """Add a root trajectory that was not asked for itself but follows from a velocity.

        ground: (K, 2), metres, for the frames from first_frame on; heading: (K) radians, or None. stride: every
        stride-th frame is constrained, counted back from the last one, and the root may sway about those; 1: every
        frame, exactly.
        """
        rows = list(range(len(ground) - 1, -1, -stride))[::-1]
        frames = [first_frame + row for row in rows]
        self.add_waypoints(frames, ground[rows], None if heading is None else heading[rows])
        if stride > 1:
            self.planned.update(frames)
            self.faced.update(frames)

    def add_all(self, other: Targets) -> None:
        """Add all targets of `other`, which override these."""
        self.planned = (self.planned - other.ground.keys()) | other.planned
        self.faced = (self.faced - other.heading.keys()) | other.faced
        self.ground |= other.ground
        self.height |= other.height
        self.heading |= other.heading
        for key in self.own_roots.keys() & other.positions.keys():
            del self.own_roots[key]
        self.own_roots |= other.own_roots
        self.positions |= other.positions
        self.rotations |= other.rotations

    def copy(self) -> Targets:
        """An independent copy."""
        other = Targets(self.skeleton)
        for name in ("ground", "height", "heading", "positions", "rotations", "own_roots", "planned", "faced"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def _add_pose_root(self, frames: Sequence[int], positions: Floats, ground: Tensor | Floats | None) -> None:
        angle = heading_angle(self.skeleton, torch.from_numpy(positions))
        self.add_waypoints(frames, positions[:, 0, [0, 2]] if ground is None else ground, angle)
        self.height.update(zip(frames, positions[:, 0, 1], strict=True))

    def add_keyframes(
        self, frames: Sequence[int], positions: Tensor | Floats, ground: Tensor | Floats | None = None
    ) -> None:
        """Add keyframes. positions: (K, J, 3), all joints; ground: (K, 2), the root's position if it is to differ."""
        frames = require_frames(frames)
        places = require_numbers("joint positions", positions, (len(frames), self.skeleton.num_joints, 3))
        self._add_pose_root(frames, places, ground)
        for row, frame in enumerate(frames):
            self.positions.update(((frame, joint), place) for joint, place in enumerate(places[row]))

    def add_end_effectors(
        self,
        frames: Sequence[int],
        limbs: Sequence[str],
        positions: Tensor | Floats,
        rotations: Tensor | Floats,
        ground: Tensor | Floats | None = None,
    ) -> None:
        """Constrain limbs, taken from whole poses.

        Sets the positions of each chain's joints, the global rotation of its first joint, and the root's ground
        position, height and heading. limbs: names from `limb_chains`; positions: (K, J, 3); rotations: (K, J, 3, 3),
        global; ground: (K, 2), the root's position if not the pose's, with which the limbs move. Raises ConstraintError
        for unknown limbs.
        """
        frames = require_frames(frames)
        places = require_numbers("joint positions", positions, (len(frames), self.skeleton.num_joints, 3))
        turns = require_rotations(rotations, (len(frames), self.skeleton.num_joints, 3, 3))
        chains = limb_chains(self.skeleton)
        if not limbs or not all(name in chains for name in limbs):
            raise ConstraintError(f"end effectors are {list(limbs)}; name one or more of {', '.join(chains)}")
        self._add_pose_root(frames, places, ground)
        for row, frame in enumerate(frames):
            for name in limbs:
                for joint in chains[name]:
                    self.positions[frame, joint] = places[row, joint]
                    self.own_roots[frame, joint] = places[row, 0, [0, 2]]
                first = chains[name][0]
                self.rotations[frame, first] = turns[row, first]

    def add_joints(
        self,
        frame: int,
        joints: Sequence[int],
        positions: Tensor | Floats,
        rotations: Tensor | Floats | None = None,
    ) -> None:
        """Constrain any joints at one frame. positions: (K, 3), world; rotations: (K, 3, 3), global, or None.

        If the root joint is among them, its ground position and height are set too, but not its heading.
        """
        (frame,) = require_frames([frame])
        places = require_numbers("joint positions", positions, (len(joints), 3))
        turns = None if rotations is None else require_rotations(rotations, (len(joints), 3, 3))
        self._require_joints(joints)
        for row, joint in enumerate(joints):
            self.positions[frame, joint] = places[row]
            self.own_roots.pop((frame, joint), None)
            if turns is not None:
                self.rotations[frame, joint] = turns[row]
            if joint == 0:
                self.ground[frame] = places[row, [0, 2]]
                self.planned.discard(frame)
                self.height[frame] = places[row, 1]

    def add_rotations(self, frame: int, joints: Sequence[int], rotations: Tensor | Floats) -> None:
        """Constrain the rotations of joints at one frame, but not their positions. rotations: (K, 3, 3), global."""
        (frame,) = require_frames([frame])
        turns = require_rotations(rotations, (len(joints), 3, 3))
        self._require_joints(joints)
        self.rotations.update(((frame, joint), turns[row]) for row, joint in enumerate(joints))

    def _require_joints(self, joints: Sequence[int]) -> None:
        if not all(0 <= joint < self.skeleton.num_joints for joint in joints):
            raise ConstraintError(
                f"joints {list(joints)} are not all in 0..{self.skeleton.num_joints - 1} of {self.skeleton.name}"
            )

    def fill(self, layout: Representation, first_frame: int, num_frames: int) -> tuple[Tensor, Tensor]:
        """Observed features in natural units and mask, each (num_frames, D), for the frames from first_frame on.

        Raises ConstraintError if joints are constrained at a frame without the root's ground position, and if `layout`
        is for another skeleton.
        """
        if layout.skeleton.joint_names != self.skeleton.joint_names:
            raise ConstraintError(
                f"the targets are of {self.skeleton.name}, the features of {layout.skeleton.name}; make targets of that"
            )
        observed = np.zeros((num_frames, layout.feature_dim), np.float32)
        mask = np.zeros_like(observed)
        end = first_frame + num_frames
        rotation, position = layout.rotation_block.start, layout.position_block.start

        def put(columns: Sequence[int], entries: Mapping[tuple[int, int], Floats | np.float32]) -> None:
            """Write values (k) by (frame, offset) into columns (k), each shifted by the offset."""
            inside = [key for key in entries if first_frame <= key[0] < end]
            if inside:
                rows, offsets = np.array(inside)[:, :, None].swapaxes(0, 1)
                where = (rows - first_frame, offsets + np.array(columns))
                observed[where] = np.array([entries[key] for key in inside]).reshape(len(inside), -1)
                mask[where] = 1

        put([0, 2], {(frame, 0): ground for frame, ground in self.ground.items()})
        put([1], {(frame, 0): height for frame, height in self.height.items()})
        put([0, 1], {(frame, layout.heading_block.start): heading for frame, heading in self.heading.items()})
        # In the order of `rotation.matrix_to_6d`: first column, then second column.
        put(
            range(6),
            {(frame, rotation + 6 * joint): turn[:, :2].T for (frame, joint), turn in self.rotations.items()},
        )
        put(
            range(3),
            {
                (frame, position + 3 * (joint - 1)): self._relative_position(frame, joint)
                for frame, joint in self.positions
                if joint > 0
            },
        )
        return torch.from_numpy(observed), torch.from_numpy(mask)

    def _relative_position(self, frame: int, joint: int) -> Floats:
        """A joint's position (3) relative to the ground below the root."""
        if frame not in self.ground:
            raise ConstraintError(
                f"frame {frame} constrains joint {self.skeleton.joint_names[joint]} but not where the root is;"
                f" give the position of {self.skeleton.joint_names[0]} at that frame too, or its place on the ground"
            )
        place = self.positions[frame, joint].copy()
        place[[0, 2]] -= self.root_of(frame, joint)
        return place

    def root_of(self, frame: int, joint: int) -> Floats | None:
        """The root's ground position (2) in the pose that a joint's target position belongs to; None if unknown.

        If the root's own position is constrained at the frame, that takes precedence over the root of the limb's pose.
        """
        root = self.positions.get((frame, 0))
        return self.own_roots.get((frame, joint), self.ground.get(frame)) if root is None else root[[0, 2]]

    def planned_frames(self, first_frame: int, num_frames: int) -> Tensor:
        """(num_frames, 2) bool for the frames from first_frame on: ground position, heading only planned."""
        flags = np.zeros((num_frames, 2), bool)
        for column, frames in enumerate((self.planned, self.faced)):
            flags[[frame - first_frame for frame in frames if 0 <= frame - first_frame < num_frames], column] = True
        return torch.from_numpy(flags)

    def observe(self, layout: Representation, first_frame: int, num_frames: int) -> tuple[Tensor, Tensor]:
        """As `fill`, but on the layout's device, with the features normalised, and zero where the mask is zero."""
        device = layout.stats.mean.device
        observed, mask = (part.to(device) for part in self.fill(layout, first_frame, num_frames))
        return layout.normalize(observed) * mask, mask
