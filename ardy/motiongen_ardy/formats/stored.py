"""StoredMotion: the content of every motion file, completed where the file lacks something."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.representation import motion_from_pose
from motiongen_ardy.core.skeleton import Skeleton, load_skeleton, skeleton_names
from motiongen_ardy.formats.bounded import check_num_frames
from motiongen_ardy.formats.errors import FormatError

ORTHONORMAL_WITHIN = 1e-3
MAX_FPS = 1000
MAX_TEXT_LENGTH = 1_000_000
_BELOW_WHOLE, _ABOVE_WHOLE = 5e-4, 1.1e-3


@dataclass(frozen=True, eq=False)
class StoredMotion:
    """One motion (T frames, no batch) with its skeleton, and the text it was generated from, if known.

    Raises FormatError for shapes that do not agree, numbers that are not finite, matrices that are not rotations, texts
    of more than a million characters, and texts with half of a surrogate pair.
    """

    skeleton: Skeleton
    motion: Motion
    text: str = ""
    source: str = "motion"

    def __post_init__(self) -> None:
        motion, joints = self.motion, self.skeleton.num_joints
        num_frames = motion.root_positions.shape[0] if motion.root_positions.ndim else 0
        check_num_frames(self.source, num_frames)
        for name, values, shape in (
            ("local rotations", motion.local_rotations, (num_frames, joints, 3, 3)),
            ("root positions", motion.root_positions, (num_frames, 3)),
            ("foot contacts", motion.foot_contacts, (num_frames, 4)),
        ):
            if tuple(values.shape) != shape:
                given = f"{name} of shape {tuple(values.shape)}"
                raise FormatError(self.source, given, f"{shape} is the shape for {self.skeleton.name}")
            if not values.isfinite().all():
                raise FormatError(self.source, f"{name} hold NaN or infinite numbers", "every one must be finite")
        if not isinstance(motion.fps, int) or isinstance(motion.fps, bool) or not 1 <= motion.fps <= MAX_FPS:
            raise FormatError(self.source, f"{motion.fps} frames a second", f"give a whole number of 1 to {MAX_FPS}")
        if len(self.text) > MAX_TEXT_LENGTH:
            raise FormatError(self.source, f"a text of {len(self.text)} characters", f"give {MAX_TEXT_LENGTH} at most")
        try:
            self.text.encode()
        except UnicodeEncodeError as error:
            given = f"a text with half of a surrogate pair, {self.text[error.start]!r}"
            raise FormatError(self.source, given, "give whole characters, which every file can hold") from None
        check_rotations(self.source, motion.local_rotations)

    def positions(self) -> Tensor:
        """World joint positions (T, J, 3), metres."""
        return self.motion.positions(self.skeleton)


def as_array(values: Tensor) -> np.ndarray:
    """A tensor of any type, on any device, with or without gradients, as a float64 array for writing."""
    array: np.ndarray = values.detach().cpu().double().contiguous().numpy()
    return array


def check_rotations(source: object, matrices: Tensor) -> None:
    """Raise FormatError unless (..., 3, 3) are rotations to within 0.001."""
    matrices = matrices if matrices.dtype in (torch.float32, torch.float64) else matrices.double()
    identity = torch.eye(3, dtype=matrices.dtype, device=matrices.device)
    bad = ((matrices.transpose(-1, -2) @ matrices - identity).abs() > ORTHONORMAL_WITHIN).flatten(-2).any(-1)
    bad |= torch.linalg.det(matrices) < 0
    if bad.any():
        given = f"{int(bad.sum())} of {bad.numel()} matrices are no rotations, the first at {bad.nonzero()[0].tolist()}"
        raise FormatError(source, given, "give orthonormal matrices with determinant 1")


def from_pose(
    skeleton: Skeleton,
    local_rotations: Tensor,
    root_positions: Tensor,
    fps: int,
    *,
    source: object,
    text: str = "",
    contacts: Tensor | None = None,
) -> StoredMotion:
    """A stored motion in float32 from poses of any precision; contacts are computed from the poses if None."""
    check_num_frames(source, len(root_positions))
    rotations, root = local_rotations.float(), root_positions.float()
    if contacts is None:
        contacts = motion_from_pose(skeleton, local_rotations.double(), root_positions.double(), fps).foot_contacts
    return StoredMotion(skeleton, Motion(rotations, root, contacts, fps), text, str(source))


def whole_fps(source: object, fps: float, given: str | None = None) -> int:
    """A frame rate as the whole number that Motion requires, to which rounded frame times (0.0333 s) come close.

    Raises FormatError for others, including those of film and television: 23.976, 29.97 and 59.94 are a thousandth
    below.
    """
    whole = round(fps) if 0 < fps <= MAX_FPS else 0
    if not whole or not -_BELOW_WHOLE <= fps / whole - 1 <= _ABOVE_WHOLE:
        said = given or f"{fps:g} frames a second"
        raise FormatError(source, said, f"give a whole number of frames a second, 1 to {MAX_FPS}; resample it first")
    return whole


def skeleton_with(source: object, joint_names: Sequence[str], wanted: Skeleton | None = None) -> Skeleton:
    """The skeleton whose joints have exactly these names, in any order; checked against `wanted` if given.

    Raises FormatError, which says which names are missing and which are too many.
    """
    candidates = [wanted] if wanted is not None else [load_skeleton(name) for name in skeleton_names()]
    for skeleton in candidates:
        if set(skeleton.joint_names) == set(joint_names):
            return skeleton
    if wanted is None:
        closest = max(candidates, key=lambda one: len(set(one.joint_names) & set(joint_names)))
    else:
        closest = wanted
    missing = [name for name in closest.joint_names if name not in set(joint_names)]
    extra = [name[:40] for name in joint_names if name not in set(closest.joint_names)]
    given = f"{len(joint_names)} joints that are not those of {closest.name}: {len(missing)} missing"
    given += f" ({', '.join(missing[:3])} ...)" if missing else ""
    given += f", {len(extra)} too many ({', '.join(extra[:3])} ...)" if extra else ""
    names = ", ".join(one.name for one in candidates)
    allowed = f"the skeletons are {names}; retarget others first, see python -m motiongen_ardy.data"
    raise FormatError(source, given, allowed)


def skeleton_of_size(source: object, num_joints: int, wanted: Skeleton | None = None) -> Skeleton:
    """The skeleton with this many joints (no two have equally many); only `wanted` if given. Raises FormatError."""
    candidates = [wanted] if wanted is not None else [load_skeleton(name) for name in skeleton_names()]
    for skeleton in candidates:
        if skeleton.num_joints == num_joints:
            return skeleton
    known = ", ".join(f"{one.num_joints} ({one.name})" for one in candidates)
    raise FormatError(source, f"{num_joints} joints", f"the numbers of joints read are {known}")


def check_bones(source: object, skeleton: Skeleton, offsets: Tensor, within_m: float = 0.01) -> None:
    """Raise FormatError if a file's offsets (J, 3) in metres are not the skeleton's: the motion would not fit it."""
    error = (offsets - torch.tensor(skeleton.offsets, device="cpu")).norm(dim=-1)
    error[0] = 0
    if float(error.max()) > within_m:
        joint = int(error.argmax())
        given = f"the bone of {skeleton.joint_names[joint]} differs by {100 * float(error[joint]):.1f} cm"
        raise FormatError(source, given, f"a file of {skeleton.name} has its bones; retarget others first")
