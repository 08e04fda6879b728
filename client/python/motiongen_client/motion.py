"""Motion as plain arrays: the rig, one frame, consecutive frames.

Right-handed, +Y up, +Z forward, metres, radians; a character that faces +Z has its left side toward +X.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, UnknownName
from motiongen_client.kinematics import forward_kinematics

Float32 = NDArray[np.float32]

ROOT_BLOCK = "root_translation_m"
ROTATION_BLOCK = "joint_rotation_quat_wxyz"
CONTACT_BLOCK = "foot_contact"
POSITIONS_BLOCK = "joint_positions_m"
GLOBAL_ROTATION_BLOCK = "joint_global_rotation_quat_wxyz"
QPOS_BLOCK = "g1_qpos"


@dataclass(frozen=True, eq=False, repr=False)
class Rig:
    """A skeleton and the layout of its frame rows, as the server's catalogue gives them.

    joint_names, parents: J of each; joint 0 is the root with parent -1, and a parent precedes its children.
    offsets_m: (J, 3) float32, from the parent in the neutral pose, metres.
    blocks: name -> width of each block of a frame row, in order; a width counts float32 numbers.
    hip_joints: right and left; the line through them gives a pose's heading. None: the root's rotation gives it.
    limbs: name -> joints of each part of the body; the first is the joint whose rotation is the limb's.
    outputs: name -> width of the additional outputs of a session (`SessionOptions.outputs`), after the blocks.
    """

    rig_id: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    offsets_m: Float32
    frame_rate_hz: int
    blocks: Mapping[str, int]
    hip_joints: tuple[int, int] | None = None
    limbs: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    outputs: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"Rig({self.rig_id}, {self.num_joints} joints, {self.frame_rate_hz} Hz)"

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)

    @cached_property
    def row_width(self) -> int:
        """Numbers in one frame row."""
        return self.own_width + sum(self.outputs.values())

    @cached_property
    def own_width(self) -> int:
        """Numbers in one frame row before the outputs."""
        return sum(self.blocks.values())

    @cached_property
    def block_columns(self) -> Mapping[str, slice]:
        """The columns of each block and each output in a frame row."""
        columns, start = {}, 0
        for name, width in (*self.blocks.items(), *self.outputs.items()):
            columns[name] = slice(start, start + width)
            start += width
        return columns

    def index(self, joint_name: str) -> int:
        """Index of a joint. Raises UnknownName, which lists the joints."""
        try:
            return self.joint_names.index(joint_name)
        except ValueError:
            raise UnknownName("joint", joint_name, self.joint_names) from None

    def columns(self, name: str) -> slice:
        """The columns of a block or an output in a frame row. Raises UnknownName, which lists all of them."""
        if name not in self.block_columns:
            raise UnknownName("block", name, list(self.block_columns))
        return self.block_columns[name]

    def with_outputs(self, outputs: Mapping[str, int]) -> Rig:
        """The same rig with these outputs, name -> width, in its rows."""
        return replace(self, outputs=dict(outputs))

    def frames_in(self, seconds: float) -> int:
        """The number of frames nearest to a duration in seconds."""
        return round(seconds * self.frame_rate_hz)


class Poser(Protocol):
    """Computes joint positions of frames."""

    def positions_m(self, index: int, row: Float32) -> Float32:
        """(J, 3) world positions of all joints, given a frame's index and row."""


@dataclass(frozen=True, eq=False, repr=False)
class Frame:
    """One pose of one character.

    index: absolute frame number since the session opened; row: (D,) float32, laid out by `rig.blocks`.
    poser: computes its joint positions together with those of its neighbours; None: they are computed alone.
    share: how far it is on the way to the next frame, 0 to 1; 0 for frames as the server sent them.
    """

    rig: Rig
    index: int
    row: Float32
    poser: Poser | None = None
    share: float = 0.0

    def __repr__(self) -> str:
        x, y, z = self.root_translation_m
        return f"Frame({self.index} of {self.rig.rig_id}, {self.time_s:.2f} s, root at {x:.2f} {y:.2f} {z:.2f} m)"

    @property
    def time_s(self) -> float:
        """Seconds since frame 0."""
        return (self.index + self.share) / self.rig.frame_rate_hz

    @property
    def root_translation_m(self) -> Float32:
        """(3,) world position of joint 0."""
        return self.row[self.rig.block_columns[ROOT_BLOCK]]

    @property
    def joint_rotation_quat_wxyz(self) -> Float32:
        """(J, 4) parent-relative rotations; joint 0 relative to the world."""
        return self.row[self.rig.block_columns[ROTATION_BLOCK]].reshape(self.rig.num_joints, 4)

    @property
    def foot_contact(self) -> Float32:
        """(4,) left heel, left toe, right heel, right toe: 1 if on the ground, else 0."""
        return self.row[self.rig.block_columns[CONTACT_BLOCK]]

    def output(self, name: str) -> Float32:
        """(W,) the numbers of a block or an output, by name. Raises UnknownName."""
        return self.row[self.rig.columns(name)]

    def joint_positions_m(self) -> Float32:
        """(J, 3) world positions of all joints."""
        if POSITIONS_BLOCK in self.rig.outputs:
            return self.output(POSITIONS_BLOCK).reshape(-1, 3)
        if self.poser is not None:
            return self.poser.positions_m(self.index, self.row)
        positions: Float32 = Motion(self.rig, self.index, self.row[None]).joint_positions_m()[0]
        return positions


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Consecutive frames of one character. first_frame: index of row 0; rows: (T, D) float32."""

    rig: Rig
    first_frame: int
    rows: Float32

    def __post_init__(self) -> None:
        if not isinstance(self.rig, Rig):
            raise InvalidInput("rig", self.rig, "a Rig")
        allowed = f"an array of float32, of shape (frames, {self.rig.row_width})"
        if not isinstance(self.rows, np.ndarray) or self.rows.dtype.kind not in "iuf":
            raise InvalidInput("rows", self.rows, allowed)
        if self.rows.ndim != 2 or self.rows.shape[1] != self.rig.row_width:
            raise InvalidInput("rows", self.rows.shape, allowed)

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        last = self.first_frame + len(self) - 1
        return f"Motion(frames {self.first_frame} to {last} of {self.rig.rig_id}, {self.duration_s:.2f} s)"

    @property
    def duration_s(self) -> float:
        return len(self.rows) / self.rig.frame_rate_hz

    @property
    def root_translation_m(self) -> Float32:
        """(T, 3) world positions of joint 0."""
        return self.rows[:, self.rig.block_columns[ROOT_BLOCK]]

    @property
    def joint_rotation_quat_wxyz(self) -> Float32:
        """(T, J, 4) parent-relative rotations; joint 0 relative to the world."""
        return self.rows[:, self.rig.block_columns[ROTATION_BLOCK]].reshape(len(self.rows), -1, 4)

    @property
    def foot_contact(self) -> Float32:
        """(T, 4) left heel, left toe, right heel, right toe: 1 if on the ground, else 0."""
        return self.rows[:, self.rig.block_columns[CONTACT_BLOCK]]

    def output(self, name: str) -> Float32:
        """(T, W) the numbers of a block or an output, by name. Raises UnknownName."""
        return self.rows[:, self.rig.columns(name)]

    def own(self) -> Motion:
        """The same frames without outputs."""
        if not self.rig.outputs:
            return self
        return Motion(self.rig.with_outputs({}), self.first_frame, self.rows[:, : self.rig.own_width])

    def joint_positions_m(self) -> Float32:
        """(T, J, 3) world positions of all joints."""
        if POSITIONS_BLOCK in self.rig.outputs:
            return self.output(POSITIONS_BLOCK).reshape(len(self.rows), -1, 3)
        positions, _ = forward_kinematics(
            self.rig.parents, self.rig.offsets_m, self.root_translation_m, self.joint_rotation_quat_wxyz
        )
        return positions.astype(np.float32, copy=False)

    def frame(self, index: int) -> Frame:
        """The frame with an absolute index. Raises InvalidInput if the motion does not contain it."""
        row = index - self.first_frame
        if not 0 <= row < len(self.rows):
            allowed = f"an index from {self.first_frame} to {self.first_frame + len(self.rows) - 1}"
            raise InvalidInput("index", index, allowed)
        return Frame(self.rig, index, self.rows[row])
