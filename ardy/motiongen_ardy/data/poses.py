"""Motions as numpy arrays, for making derived clips: sampling between frames, headings, contacts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from motiongen_ardy.core.rotation import matrix_to_quaternion, quaternion_to_matrix
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics
from motiongen_ardy.data.dataset import Clip

# A foot joint is in contact while it is slower than this, and lower than this above its resting height.
CONTACT_M_S = 0.45
CONTACT_RISE_M = 0.035


@dataclass(frozen=True, eq=False)
class Poses:
    """A motion: local quaternions (T, J, 4) as (w, x, y, z), root positions (T, 3) in metres, float64.

    contacts: (T, 2, 2) bool, left and right foot, each ankle and toe base.
    """

    quaternions: np.ndarray
    root: np.ndarray
    contacts: np.ndarray

    @property
    def num_frames(self) -> int:
        return len(self.root)

    def at(self, times: np.ndarray) -> Poses:
        """The motion at fractional frames (N,), by cubic interpolation, clamped to its ends."""
        first = np.clip(np.floor(times).astype(int), 0, max(self.num_frames - 2, 0))
        part = np.clip(times - first, 0, 1)
        nearest = np.clip(np.round(times).astype(int), 0, self.num_frames - 1)
        quaternions = cubic(self.quaternions, first, part[:, None, None])
        quaternions = quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True)
        return Poses(quaternions, cubic(self.root, first, part[:, None]), self.contacts[nearest])


def cubic(values: np.ndarray, first: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Catmull-Rom interpolation of values (T, ...) between frames first (N,) and first + 1, at part (N, 1...)."""
    last = len(values) - 1
    before, start = values[np.maximum(first - 1, 0)], values[first]
    end, after = values[np.minimum(first + 1, last)], values[np.minimum(first + 2, last)]
    out = end - before, 2 * before - 5 * start + 4 * end - after, 3 * start - before - 3 * end + after
    return start + 0.5 * part * (out[0] + part * (out[1] + part * out[2]))


def global_pose(skeleton: Skeleton, quaternions: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Global rotations (T, J, 3, 3) and world positions (T, J, 3)."""
    rotations, positions = forward_kinematics(
        skeleton, quaternion_to_matrix(torch.from_numpy(quaternions)), torch.from_numpy(root)
    )
    return rotations.numpy(), positions.numpy()


def quaternions_of(matrices: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) as quaternions (..., 4)."""
    return matrix_to_quaternion(torch.from_numpy(np.ascontiguousarray(matrices))).numpy()


def continuous(quaternions: np.ndarray) -> np.ndarray:
    """The same rotations (T, J, 4) with signs chosen so that quaternions do not flip between frames."""
    dots = (quaternions[1:] * quaternions[:-1]).sum(-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * signs[..., None]])


def multiply(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Quaternion products (..., 4): second is applied first."""
    a, b = np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0)
    return np.stack(
        [
            a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
            a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
            a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
            a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
        ],
        axis=-1,
    )


def yaw_quaternion(angle: np.ndarray) -> np.ndarray:
    """Radians (...) about +Y as quaternions (..., 4)."""
    zero = np.zeros_like(angle)
    return np.stack([np.cos(angle / 2), zero, np.sin(angle / 2), zero], axis=-1)


def yaw_matrix(angle: np.ndarray) -> np.ndarray:
    """Radians (...) about +Y as matrices (..., 3, 3)."""
    cosine, sine, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    rows = [cosine, zero, sine, zero, one, zero, -sine, zero, cosine]
    return np.stack(rows, axis=-1).reshape(*np.shape(angle), 3, 3)


def yaw_of(rotations: np.ndarray) -> np.ndarray:
    """The heading of global rotations (T, 3, 3), from their left axis: radians, 0 along +Z, unwrapped."""
    return np.unwrap(np.arctan2(-rotations[:, 2, 0], rotations[:, 0, 0]))


def smooth(values: np.ndarray, sigma: float) -> np.ndarray:
    """Values (T, ...) smoothed by a Gaussian of `sigma` frames; beyond the ends they are extrapolated linearly."""
    if sigma <= 0 or len(values) < 3:
        return values
    reach = min(int(np.ceil(3 * sigma)), len(values) - 1)
    before = 2 * values[:1] - values[reach:0:-1]
    after = 2 * values[-1:] - values[-2 : -reach - 2 : -1]
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    kernel /= kernel.sum()
    padded = np.concatenate([before, values, after]).reshape(len(values) + 2 * reach, -1)
    columns = [np.convolve(padded[:, column], kernel, "valid") for column in range(padded.shape[1])]
    return np.stack(columns, axis=-1).reshape(values.shape)


def contacts_of(skeleton: Skeleton, positions: np.ndarray, fps: float) -> np.ndarray:
    """Which foot joints stand (T, 2, 2), from world positions (T, J, 3): slow between neighbours, and low."""
    joints = positions[:, list(skeleton.contact_joints)]
    # Half a frame to either side: the slower of the two steps, so that a touch-down counts from its own frame on.
    steps = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * fps
    speed = np.minimum(np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]]))
    rest = np.quantile(joints[..., 1], 0.1, axis=0)
    return ((speed < CONTACT_M_S) & (joints[..., 1] < rest + CONTACT_RISE_M)).reshape(-1, 2, 2)


def poses_of(clip: Clip, skeleton: Skeleton, fps: float) -> Poses:
    """A clip of the set as arrays, with its contacts."""
    quaternions = continuous(clip.local_rotations.double().numpy())
    root = clip.root_positions.double().numpy().copy()
    _, positions = global_pose(skeleton, quaternions, root)
    return Poses(quaternions, root, contacts_of(skeleton, positions, fps))


def runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """Stretches (first frame, end frame) in which flags (T,) are set."""
    edges = np.diff(np.concatenate([[0], flags.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def smoothstep(part: np.ndarray) -> np.ndarray:
    """0 to 1 with zero slope at both ends, for part (...) in 0..1."""
    part = np.clip(part, 0, 1)
    return part * part * (3 - 2 * part)
