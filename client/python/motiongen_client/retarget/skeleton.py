"""UserSkeleton: the skeleton to which motion is retargeted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from motiongen_client.errors import InvalidInput, UnknownName
from motiongen_client.kinematics import forward_kinematics
from motiongen_client.types import as_array

Float64 = NDArray[np.float64]
_UNIT_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False)
class UserSkeleton:
    """A joint tree in our axes (right-handed, +Y up, +Z forward), in its own units.

    joint_names, parents: J of each; joint 0 is the root with parent -1, parents precede their children.
    offsets: (J, 3), each joint's position in its parent's axes; the root's affects only `rest_positions`.
    rest_quat_wxyz: (J, 4), each joint's rotation relative to its parent at rest; None: no rotation. A joint that no
    rule drives keeps it.
    """

    joint_names: Sequence[str]
    parents: Sequence[int]
    offsets: NDArray[np.floating]
    rest_quat_wxyz: NDArray[np.floating] | None = None

    def __post_init__(self) -> None:
        names, count = tuple(self.joint_names), len(self.joint_names)
        object.__setattr__(self, "joint_names", names)
        object.__setattr__(self, "parents", tuple(int(parent) for parent in self.parents))
        if not count or len(set(names)) != count:
            raise InvalidInput("joint_names", names, "one name or more, each once")
        if len(self.parents) != count or any(
            not -1 <= parent < joint or (parent < 0) != (joint == 0) for joint, parent in enumerate(self.parents)
        ):
            raise InvalidInput("parents", self.parents, f"{count} indices, -1 for joint 0 alone, parents first")
        object.__setattr__(self, "offsets", as_array("offsets", self.offsets, (count, 3)).astype(np.float64))
        rest = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)) if self.rest_quat_wxyz is None else self.rest_quat_wxyz
        turns = as_array("rest_quat_wxyz", rest, (count, 4)).astype(np.float64)
        if np.abs(np.linalg.norm(turns, axis=1) - 1).max() > _UNIT_TOLERANCE:
            raise InvalidInput("rest_quat_wxyz", "quaternions of other lengths", "unit quaternions w, x, y, z")
        object.__setattr__(self, "rest_quat_wxyz", turns)

    @cached_property
    def rest(self) -> Float64:
        """(J, 4) `rest_quat_wxyz`, which is never None here."""
        assert self.rest_quat_wxyz is not None  # set by __post_init__
        return np.asarray(self.rest_quat_wxyz, np.float64)

    def index(self, joint_name: str) -> int:
        """Index of a joint. Raises UnknownName, which lists the joints."""
        if joint_name not in self.joint_names:
            raise UnknownName("joint of the skeleton", joint_name, self.joint_names)
        return self.joint_names.index(joint_name)

    def rest_positions(self) -> Float64:
        """(J, 3) positions of the joints at rest, with the root at its offset, in the skeleton's units."""
        positions, _ = forward_kinematics(self.parents, self.offsets, self.offsets[0], self.rest)
        return np.asarray(positions, np.float64)

    def chain_length(self, joints: Sequence[str]) -> float:
        """The total length of the bones to each of the joints but the first, in the skeleton's units."""
        return float(sum(np.linalg.norm(self.offsets[self.index(name)]) for name in joints[1:]))
