"""Skeletons: joints, parents, neutral pose, and forward kinematics.

Joint 0 is the root, and parents precede their children. Positions are in metres, right-handed, +Y up, +Z forward; a
rotation matrix acts on column vectors. The skeletons are JSON files in ``ardy/motiongen_ardy/skeletons/``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib import resources

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constants import MOST_TABLES, constant, index
from motiongen_ardy.core.rotation import quaternion_components, relative_components


class UnknownSkeleton(ValueError):
    """Raised for a skeleton name that is not one of `skeleton_names()`."""


class JointsMismatch(ValueError):
    """Raised for rotations of more or fewer joints than the skeleton has."""


class UnknownJoint(ValueError):
    """Raised for a joint name that the skeleton does not have."""


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A joint tree with a neutral pose.

    neutral_joints: (J, 3) float64, metres, relative to the root joint.
    hip_joints: the (right, left) hip joint indices, which define the heading of a pose.
    left_foot to right_hand: joint indices of a chain, proximal first (ankle, toe base; hand, hand end).
    """

    name: str
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    neutral_joints: np.ndarray
    hip_joints: tuple[int, int]
    left_foot: tuple[int, ...]
    right_foot: tuple[int, ...]
    left_hand: tuple[int, ...]
    right_hand: tuple[int, ...]

    @property
    def num_joints(self) -> int:
        return len(self.joint_names)

    @property
    def feature_dim(self) -> int:
        """Width D of one feature frame: 3 + 2 + 3(J-1) + 6J + 3J + 4."""
        return 12 * self.num_joints + 6

    @property
    def contact_joints(self) -> tuple[int, int, int, int]:
        """The joints of the four contact labels: left heel, left toe, right heel, right toe."""
        return (self.left_foot[0], self.left_foot[1], self.right_foot[0], self.right_foot[1])

    @cached_property
    def offsets(self) -> np.ndarray:
        """(J, 3) float64 metres: each joint's neutral position relative to its parent; zero for the root."""
        parents = np.maximum(self.parents, 0)
        offsets: np.ndarray = self.neutral_joints - self.neutral_joints[parents]
        offsets.setflags(write=False)
        return offsets

    @cached_property
    def offset_rows(self) -> tuple[tuple[float, ...], ...]:
        """`offsets` as nested tuples, hashable, as `constant` takes them."""
        return tuple(tuple(float(number) for number in row) for row in self.offsets)

    @cached_property
    def chain_rows(self) -> tuple[tuple[float, ...], ...]:
        """(J, J): row j has a 1 for joint j and each of its ancestors, else 0."""
        rows: list[list[float]] = []
        for joint, parent in enumerate(self.parents):
            row = list(rows[parent]) if parent >= 0 else [0.0] * self.num_joints
            row[joint] = 1.0
            rows.append(row)
        return tuple(tuple(row) for row in rows)

    def index(self, joint_name: str) -> int:
        """The index of a joint. Raises UnknownJoint, which lists the skeleton's joints."""
        try:
            return self.joint_names.index(joint_name)
        except ValueError:
            raise UnknownJoint(
                f"skeleton {self.name} has no joint {joint_name!r}; its joints are {', '.join(self.joint_names)}"
            ) from None


def skeleton_names() -> tuple[str, ...]:
    """The names that `load_skeleton` accepts."""
    folder = resources.files("motiongen_ardy") / "skeletons"
    return tuple(sorted(entry.name[: -len(".json")] for entry in folder.iterdir() if entry.name.endswith(".json")))


@lru_cache
def load_skeleton(name: str) -> Skeleton:
    """The skeleton called `name`, for example "core27". Raises UnknownSkeleton, which lists the known names."""
    if name not in skeleton_names():
        raise UnknownSkeleton(f"no skeleton {name!r}; known skeletons are {', '.join(skeleton_names())}")
    facts = json.loads((resources.files("motiongen_ardy") / "skeletons" / f"{name}.json").read_text(encoding="utf-8"))
    joint_names = tuple(facts["joint_names"])
    neutral = np.asarray(facts["neutral_joints_m"], dtype=np.float64)
    neutral = neutral - neutral[0]
    neutral.setflags(write=False)  # all callers share it

    def indices(key: str) -> tuple[int, ...]:
        return tuple(joint_names.index(joint) for joint in facts[key])

    right_hip, left_hip = indices("hip_joints_right_left")
    return Skeleton(
        name=facts["name"],
        joint_names=joint_names,
        parents=tuple(facts["parents"]),
        neutral_joints=neutral,
        hip_joints=(right_hip, left_hip),
        left_foot=indices("left_foot_chain"),
        right_foot=indices("right_foot_chain"),
        left_hand=indices("left_hand_chain"),
        right_hand=indices("right_hand_chain"),
    )


def forward_kinematics(skeleton: Skeleton, local_rotations: Tensor, root_positions: Tensor) -> tuple[Tensor, Tensor]:
    """Global rotations and world positions of all joints.

    local_rotations: (..., J, 3, 3) parent-relative; root_positions: (..., 3) metres.
    Returns global rotations (..., J, 3, 3) and positions (..., J, 3) in metres. For a joint j with parent a:
    G_j = G_a R_j and q_j = q_a + G_a (n_j - n_a). Raises JointsMismatch.
    """
    if local_rotations.shape[-3] != skeleton.num_joints:
        raise JointsMismatch(
            f"rotations of {local_rotations.shape[-3]} joints; the skeleton {skeleton.name} has {skeleton.num_joints}"
        )
    offsets = constant(skeleton.offset_rows, local_rotations.dtype, local_rotations.device)
    rotations: list[Tensor] = [local_rotations[..., 0, :, :]]
    positions: list[Tensor] = [torch.zeros_like(root_positions)]
    for joint in range(1, skeleton.num_joints):
        parent = skeleton.parents[joint]
        rotations.append(rotations[parent] @ local_rotations[..., joint, :, :])
        positions.append(positions[parent] + rotations[parent] @ offsets[joint])
    return torch.stack(rotations, dim=-3), torch.stack(positions, dim=-2) + root_positions.unsqueeze(-2)


def positions_from_global(skeleton: Skeleton, global_rotations: Tensor, root_positions: Tensor) -> Tensor:
    """World positions (..., J, 3) in metres from global rotations (..., J, 3, 3) and root positions (..., 3).

    Equals `forward_kinematics` of the matching local rotations, but without a chain of matrix products, which makes it
    the form to use in losses.
    """
    *leading, joints, _, _ = global_rotations.shape
    batch, others = (leading[0], math.prod(leading[1:])) if leading else (1, 1)
    # A position is a sum over the bones that lead to it, so all positions of a row are one matrix product. Not one
    # product for all rows: a row's result must not depend on the number of rows.
    rows = global_rotations.transpose(-3, -2).reshape(batch, 3 * others, 3 * joints)
    places = torch.bmm(rows, _place_matrix(skeleton, rows.dtype, rows.device).expand(batch, -1, -1))
    return places.view(*leading, 3, joints).transpose(-1, -2) + root_positions.unsqueeze(-2)


def hip_lines(skeleton: Skeleton, global_rotations: Tensor) -> Tensor:
    """Vectors (..., 3) in metres from the left hip to the right one, from global rotations (..., J, 3, 3)."""
    right, left = skeleton.hip_joints
    places = _place_matrix(skeleton, global_rotations.dtype, global_rotations.device)
    line = (places[:, right] - places[:, left]).view(-1, 3)
    bones = index(_bones_to(skeleton, right, left), line.device)
    return (global_rotations.index_select(-3, bones) * line[bones, None]).sum(dim=(-3, -1))


@lru_cache(maxsize=64)
def _bones_to(skeleton: Skeleton, *joints: int) -> tuple[int, ...]:
    """The ancestors of the given joints, whose rotations determine the joints' positions."""
    found: set[int] = set()
    for joint in joints:
        while (joint := skeleton.parents[joint]) >= 0:
            found.add(joint)
    return tuple(sorted(found))


@lru_cache(maxsize=MOST_TABLES)
def _place_matrix(skeleton: Skeleton, dtype: torch.dtype, device: torch.device) -> Tensor:
    """(3J, J): times the columns of all joints' rotations, gives the position of every joint, with the root at zero."""
    chains, places = np.asarray(skeleton.chain_rows), np.zeros((skeleton.num_joints, 3, skeleton.num_joints))
    for joint, parent in enumerate(skeleton.parents[1:], 1):
        places[parent] += skeleton.offsets[joint][:, None] * chains[:, joint]
    with torch.inference_mode(False):  # a table first created while serving may later be used in training
        return torch.tensor(places.reshape(-1, skeleton.num_joints), dtype=dtype, device=device)


def global_to_local(skeleton: Skeleton, global_rotations: Tensor) -> Tensor:
    """Parent-relative rotations from global ones, both (..., J, 3, 3): R_0 = G_0, R_j = G_a^T G_j."""
    parents = index(tuple(skeleton.parents[1:]), global_rotations.device)
    parent_rotations = global_rotations.index_select(-3, parents)
    children = parent_rotations.transpose(-1, -2) @ global_rotations[..., 1:, :, :]
    return torch.cat([global_rotations[..., :1, :, :], children], dim=-3)


def local_quaternions(skeleton: Skeleton, global_rotations: Tensor) -> Tensor:
    """Parent-relative rotations as quaternions (4, ..., J), components w, x, y, z first, from global (..., J, 3, 3).

    The same as the quaternions of `global_to_local`, up to their signs, at a third of the cost.
    """
    parents = index(tuple(max(parent, 0) for parent in skeleton.parents), global_rotations.device)
    whole = quaternion_components(global_rotations)
    local = relative_components(whole.index_select(-1, parents), whole)
    local[..., 0] = whole[..., 0]
    return local
