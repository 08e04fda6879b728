"""Sampler: poses between frames, for a loop that draws faster than the frame rate, with jumps faded out.

Between two frames the root moves in a straight line, joints turn the shorter way at a constant rate (Shoemake 1985,
slerp), and contacts are those of the nearer frame. If the frame being approached is replaced, or arrives only after the
last pose had to be held, the new pose differs from the one shown: that difference is added to what follows and fades.
"""

from __future__ import annotations

import numpy as np

from motiongen_client.motion import ROOT_BLOCK, ROTATION_BLOCK, Float32, Rig
from motiongen_client.playback import Playback

_NEARLY_ONE = 0.9995  # above it, lerp equals slerp within float32, while slerp divides by nearly zero

_NO_TURN = np.array([1, 0, 0, 0], np.float32)
_CONJUGATE = np.array([1, -1, -1, -1], np.float32)


def slerp(earlier: Float32, later: Float32, share: float) -> Float32:
    """Rotations `share` of the way (0 to 1) between (..., 4) unit quaternions, the shorter way round."""
    dots = np.einsum("...i,...i->...", earlier, later)[..., None]
    later, dots = np.where(dots < 0, -later, later), np.abs(dots)
    angles = np.arccos(np.minimum(dots, _NEARLY_ONE))
    sines = np.sin(angles)
    near, far = np.sin((1 - share) * angles) / sines, np.sin(share * angles) / sines
    straight = dots > _NEARLY_ONE
    mixed = np.where(straight, 1 - share, near) * earlier + np.where(straight, share, far) * later
    between: Float32 = (mixed / np.linalg.norm(mixed, axis=-1, keepdims=True)).astype(np.float32)
    return between


def between_rows(rig: Rig, earlier: Float32, later: Float32, share: float) -> Float32:
    """(D,) the row `share` of the way between the rows of two frames, without outputs."""
    row = (later if share > 0.5 else earlier)[: rig.own_width].copy()
    root, joints = rig.block_columns[ROOT_BLOCK], rig.block_columns[ROTATION_BLOCK]
    row[root] = (1 - share) * earlier[root] + share * later[root]
    row[joints] = slerp(earlier[joints].reshape(-1, 4), later[joints].reshape(-1, 4), share).ravel()
    return row


class Sampler:
    """Samples one playback at any moment. blend_s: how long a jump takes to fade; 0: jumps are not faded."""

    def __init__(self, rig: Rig, playback: Playback, blend_s: float = 0.15) -> None:
        self.blend_s = blend_s
        self._rig = rig
        self._playback = playback
        self._index = -1
        self._approached: Float32 | None = None
        self._shown: Float32 | None = None
        self._apart: tuple[Float32, Float32] | None = None  # the pose shown relative to the one due: root, joints
        self._faded_at_s = 0.0

    @property
    def is_fading(self) -> bool:
        """Whether a jump is being faded out."""
        return self._apart is not None

    def row(self, now_s: float) -> tuple[float, Float32]:
        """The share of the way from the playhead to the next frame, 0 to 1, and the (D,) row to show."""
        playback, index = self._playback, self._playback.playhead
        here = playback.row(index)
        is_there = index + 1 < playback.buffered_to
        ahead = playback.row(index + 1) if is_there else here
        share = playback.share(now_s) if is_there and not playback.is_cut(index + 1) else 0.0
        target = between_rows(self._rig, here, ahead, share)
        if self._shown is not None and self._has_jumped(index, here, ahead):
            self._apart, self._faded_at_s = self._gap(self._shown, target), now_s + self.blend_s
        self._index, self._approached = index, ahead
        self._shown = shown = self._bridged(target, now_s)
        return share, shown

    def _has_jumped(self, index: int, here: Float32, ahead: Float32) -> bool:
        if index == self._index:
            return ahead is not self._approached
        cut = self._playback.cut_before(index + 1)
        if cut is not None and cut > self._index:
            self._apart = None  # the difference being faded belongs to the motion before the cut
            return False
        return index == self._index + 1 and here is not self._approached

    def _gap(self, shown: Float32, target: Float32) -> tuple[Float32, Float32]:
        root, joints = self._rig.block_columns[ROOT_BLOCK], self._rig.block_columns[ROTATION_BLOCK]
        return shown[root] - target[root], product(shown[joints].reshape(-1, 4), inverse(target[joints].reshape(-1, 4)))

    def _bridged(self, target: Float32, now_s: float) -> Float32:
        left = (self._faded_at_s - now_s) / self.blend_s if self.blend_s else 0.0
        if self._apart is None or left <= 0:
            self._apart = None
            return target
        weight = left * left * (3 - 2 * left)  # begins and ends smoothly
        root, joints = self._rig.block_columns[ROOT_BLOCK], self._rig.block_columns[ROTATION_BLOCK]
        off_m, turned = self._apart
        row = target.copy()
        row[root] += weight * off_m
        part = slerp(np.broadcast_to(_NO_TURN, turned.shape), turned, weight)
        row[joints] = product(part, target[joints].reshape(-1, 4)).ravel()
        return row


def product(first: Float32, second: Float32) -> Float32:
    """(..., 4) w x y z: the rotation `second` followed by `first`."""
    w, v = first[..., :1], first[..., 1:]
    u, x = second[..., :1], second[..., 1:]
    scalar = w * u - np.einsum("...i,...i->...", v, x)[..., None]
    return np.concatenate((scalar, w * x + u * v + np.cross(v, x)), axis=-1)


def inverse(quaternion: Float32) -> Float32:
    """(..., 4) unit quaternions -> those of the inverse rotations."""
    back: Float32 = quaternion * _CONJUGATE
    return back
