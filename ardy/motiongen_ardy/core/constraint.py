"""Constraints: waypoint, root trajectory, keyframe, end effector -> observed features and mask.

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
    """The joint chains that end-effector constraints can name."""
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
    """What features shall be at which frames, gathered from constraints; of two that disagree, the later one holds.

    Frames are absolute, from 0; `fill` is told which of them it is to lay out, and leaves the others alone. The groups
    are independent: a waypoint overrides the ground position of an earlier keyframe at its frame but not its pose.
    planned, faced: frames whose ground position, and whose heading, nobody asked for, but which lead to what was asked:
    the root may sway about them. All is held, and may be given, as float32 arrays on the CPU: there are many small
    ones, and tensors take longer to make. ground: (2); height: (); heading: (2) cosine and sine; positions: (3);
    rotations: (3, 3). own_roots: (2), where the root is in the pose that a limb was taken from, of limbs without it.
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
        """Waypoints or a root trajectory. ground: (K, 2) x and z in metres; heading: (K) radians, or None."""
        frames = require_frames(frames)
        places = require_numbers("ground positions", ground, (len(frames), 2))
        angles = None if heading is None else require_numbers("headings", heading, (len(frames),))
        self.ground.update(zip(frames, places, strict=True))
        self.planned.difference_update(frames)
        if angles is not None:
            self.add_heading(frames, angles)

    def add_heading(self, frames: Sequence[int], heading: Tensor | Floats) -> None:
        """The root's facing alone. heading: (K) radians."""
        frames = require_frames(frames)
        angles = require_numbers("headings", heading, (len(frames),))
        self.heading.update(zip(frames, facings(angles), strict=True))
        self.faced.difference_update(frames)

    def add_lead(self, first_frame: int, ground: Tensor | Floats, heading: Tensor | Floats | None, stride: int) -> None:
        """A root trajectory that nobody asked for in itself: it leads along a velocity.

        ground: (K, 2) metres of the frames from first_frame on; heading: (K) radians, or None. stride: one frame in so
        many is asked for, the last among them, and the root may sway about them; 1: every frame, exactly.
        """
        rows = list(range(len(ground) - 1, -1, -stride))[::-1]
        frames = [first_frame + row for row in rows]
        self.add_waypoints(frames, ground[rows], None if heading is None else heading[rows])
        if stride > 1:
            self.planned.update(frames)
            self.faced.update(frames)

    def add_all(self, other: Targets) -> None:
        """Everything that other targets ask for, over what these do."""
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
        """The same targets, to be changed apart from these."""
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
        """Keyframes. positions: (K, J, 3) of all joints; ground: (K, 2), where the root shall be if elsewhere."""
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
        """Limbs of whole poses: positions of each chain's joints, rotation of its first, and the root's ground,
        height and heading. limbs: names out of `limb_chains`; positions: (K, J, 3); rotations: (K, J, 3, 3) global;
        ground: (K, 2), where the root shall be if elsewhere, the limbs being as far from it as in their pose.
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
        """Any joints at one frame. positions: (K, 3) world; rotations: (K, 3, 3) global, or None.

        The root joint among them also sets the root's ground position and height, but no heading.
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
        """How joints are turned at one frame, wherever they are. rotations: (K, 3, 3) global."""
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
        """Observed features in natural units and mask, each (num_frames, D), of frames from first_frame on.

        Raises ConstraintError where joints are constrained without the ground position of the root, and for a layout of
        another skeleton.
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
            """Values (k) by (frame, offset), into columns (k) that the offset is added to."""
            inside = [key for key in entries if first_frame <= key[0] < end]
            if inside:
                rows, offsets = np.array(inside)[:, :, None].swapaxes(0, 1)
                where = (rows - first_frame, offsets + np.array(columns))
                observed[where] = np.array([entries[key] for key in inside]).reshape(len(inside), -1)
                mask[where] = 1

        put([0, 2], {(frame, 0): ground for frame, ground in self.ground.items()})
        put([1], {(frame, 0): height for frame, height in self.height.items()})
        put([0, 1], {(frame, layout.heading_block.start): heading for frame, heading in self.heading.items()})
        # As `rotation.matrix_to_6d` has them: first column, then second column.
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
        """A joint's position (3) from the ground below the root."""
        if frame not in self.ground:
            raise ConstraintError(
                f"frame {frame} constrains joint {self.skeleton.joint_names[joint]} but not where the root is;"
                f" give the position of {self.skeleton.joint_names[0]} at that frame too, or its place on the ground"
            )
        place = self.positions[frame, joint].copy()
        place[[0, 2]] -= self.root_of(frame, joint)
        return place

    def root_of(self, frame: int, joint: int) -> Floats | None:
        """Where (2) the root is in the pose that a joint's position is of, None where nothing tells.

        A root whose position is asked at the frame comes before the one of the limb's own pose, whoever asked for it.
        """
        root = self.positions.get((frame, 0))
        return self.own_roots.get((frame, joint), self.ground.get(frame)) if root is None else root[[0, 2]]

    def planned_frames(self, first_frame: int, num_frames: int) -> Tensor:
        """(num_frames, 2) bool of frames from first_frame on: whose ground position, whose heading was only planned."""
        flags = np.zeros((num_frames, 2), bool)
        for column, frames in enumerate((self.planned, self.faced)):
            flags[[frame - first_frame for frame in frames if 0 <= frame - first_frame < num_frames], column] = True
        return torch.from_numpy(flags)

    def observe(self, layout: Representation, first_frame: int, num_frames: int) -> tuple[Tensor, Tensor]:
        """As `fill`, on the layout's device, the observed features normalised and zero where the mask is zero."""
        device = layout.stats.mean.device
        observed, mask = (part.to(device) for part in self.fill(layout, first_frame, num_frames))
        return layout.normalize(observed) * mask, mask
