"""Joins two motions: crossfades around a foot that stays in place, starts from standing, and stops into it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.poses import (
    Poses,
    global_pose,
    multiply,
    runs,
    smooth,
    smoothstep,
    yaw_matrix,
    yaw_of,
    yaw_quaternion,
)

# Frames at the start and at the end of a swing in which the foot still stands.
SWING_MARGIN = 1


@dataclass(frozen=True)
class Pass:
    """A moment at which one foot stands (`stance`, 0 left, 1 right) and the other passes it in the air.

    lifted, landed: the first and last frame of that swing.
    """

    frame: float
    stance: int
    lifted: int
    landed: int


def heading_at(skeleton: Skeleton, poses: Poses, frame: int) -> float:
    """Heading in radians around a frame, smoothed to remove the twist of steps."""
    rotations, _ = global_pose(skeleton, poses.quaternions[:, :], poses.root)
    return float(smooth(yaw_of(rotations[:, 0]), 8.0)[frame])


def passes(skeleton: Skeleton, poses: Poses) -> list[Pass]:
    """All moments of a walk or run at which a swinging foot passes the standing one."""
    _, positions = global_pose(skeleton, poses.quaternions, poses.root)
    ankles = positions[:, [skeleton.left_foot[0], skeleton.right_foot[0]]][:, :, [0, 2]]
    way = np.gradient(smooth(poses.root[:, [0, 2]], 8.0), axis=0)
    way /= np.maximum(np.linalg.norm(way, axis=-1, keepdims=True), 1e-9)
    standing = poses.contacts.any(-1)
    found = []
    for stance in (0, 1):
        ahead = ((ankles[:, 1 - stance] - ankles[:, stance]) * way).sum(-1)
        for start, end in runs(~standing[:, 1 - stance]):
            if start == 0 or end == len(ahead):
                continue
            crossing = [
                f for f in range(start, end) if ahead[f - 1] < 0 <= ahead[f] and standing[f - 1 : f + 1, stance].all()
            ]
            if crossing:
                frame = crossing[0]
                part = ahead[frame - 1] / (ahead[frame - 1] - ahead[frame])
                found.append(Pass(frame - 1 + part, stance, start, end))
    return sorted(found, key=lambda entry: entry.frame)


def join(skeleton: Skeleton, first: Poses, second: Poses, overlap: int, anchors: tuple[int, ...] = ()) -> Poses:
    """Crossfade the last `overlap` frames of one motion into the first of another, which is turned and moved to fit.

    The root follows the blended velocities. anchors: feet (0 left, 1 right) whose mean position is the same before and
    after the crossfade. Contacts are those of the motion with the larger weight.
    """
    begin = first.num_frames - overlap
    turn = heading_at(skeleton, first, begin + overlap // 2) - heading_at(skeleton, second, overlap // 2)
    quaternions = second.quaternions.copy()
    quaternions[:, 0] = multiply(yaw_quaternion(np.array(turn)), quaternions[:, 0])
    root = (yaw_matrix(np.array(turn)) @ second.root[..., None])[..., 0]
    weight = smoothstep((np.arange(overlap) + 1) / (overlap + 1))

    share = weight[:, None, None]
    tail, head = first.quaternions[begin:], quaternions[:overlap]
    # Neighbouring frames already have matching signs, so one sign per joint keeps the blend continuous.
    sign = np.where((tail[0] * head[0]).sum(-1) < 0, -1.0, 1.0)[:, None]
    quaternions = quaternions * sign
    mixed = (1 - share) * tail + share * quaternions[:overlap]
    mixed /= np.linalg.norm(mixed, axis=-1, keepdims=True)

    velocity = (1 - weight[1:, None]) * np.diff(first.root[begin:], axis=0) + weight[1:, None] * np.diff(
        root[:overlap], axis=0
    )
    blended = first.root[begin] + np.concatenate([np.zeros((1, 3)), np.cumsum(velocity, axis=0)])
    blended[:, 1] = (1 - weight) * first.root[begin:, 1] + weight * root[:overlap, 1]
    if anchors:
        toes = [(skeleton.left_foot, skeleton.right_foot)[side][1] for side in anchors]
        _, positions = global_pose(skeleton, mixed[[0, -1]], blended[[0, -1]])
        moved = positions[1, toes].mean(0) - positions[0, toes].mean(0)
        part = smoothstep(np.arange(overlap) / (overlap - 1))
        blended[:, [0, 2]] -= part[:, None] * moved[[0, 2]]
    shift = blended[-1] - root[overlap - 1]
    rest = root[overlap:] + np.array([shift[0], 0.0, shift[2]])
    contacts = np.where((weight < 0.5)[:, None, None], first.contacts[begin:], second.contacts[:overlap])
    return Poses(
        np.concatenate([first.quaternions[:begin], mixed, quaternions[overlap:]]),
        np.concatenate([first.root[:begin], blended, rest]),
        np.concatenate([first.contacts[:begin], contacts, second.contacts[overlap:]]),
    )


def start(skeleton: Skeleton, standing: Poses, moving: Poses, at: Pass, ramp: int) -> tuple[Poses, int]:
    """From standing into a walk or run: the stance foot of `at` stays in place, the other swings into the first step.

    ramp: frames in which playback accelerates from rest to full rate. Returns the raw motion and its first changed
    frame.
    """
    rate = smoothstep((np.arange(4 * ramp) + 1) / ramp)
    times = at.frame + np.cumsum(rate) - rate[0]
    swing = int(np.searchsorted(times, at.landed))
    count = int(np.searchsorted(times, moving.num_frames - 1, side="right"))
    if count == len(times):
        later = np.arange(times[-1] + 1, moving.num_frames - 1)
        times = np.concatenate([times, later])
        count = len(times)
    walk = moving.at(times[:count])
    overlap = min(max(swing, 6), count - 1, standing.num_frames - 1)
    begin = standing.num_frames - overlap
    joined = join(skeleton, standing, walk, overlap, (at.stance,))
    joined.contacts[begin : begin + swing, 1 - at.stance] = False
    joined.contacts[begin : begin + 1 + SWING_MARGIN, 1 - at.stance] = True
    joined.contacts[begin : begin + overlap, at.stance] = True
    return joined, begin


def stop(skeleton: Skeleton, moving: Poses, standing: Poses, at: Pass, ramp: int) -> tuple[Poses, int]:
    """From a walk or run into standing: `start` reversed in time. Returns the motion and its first changed frame."""
    rate = smoothstep((np.arange(4 * ramp) + 1) / ramp)
    back = at.frame - (np.cumsum(rate) - rate[0])
    swing = int(np.searchsorted(-back, -(at.lifted - 1)))
    count = int(np.searchsorted(-back, 0, side="right"))
    if count == len(back):
        back = np.concatenate([back, np.arange(back[-1] - 1, 0, -1)])
        count = len(back)
    walk = moving.at(back[:count][::-1])
    overlap = min(max(swing, 6), count - 1, standing.num_frames - 1)
    begin = walk.num_frames - overlap
    joined = join(skeleton, walk, standing, overlap, (at.stance,))
    end = begin + overlap
    joined.contacts[begin:end, at.stance] = True
    joined.contacts[end - swing : end, 1 - at.stance] = False
    joined.contacts[end - 1 - SWING_MARGIN : end, 1 - at.stance] = True
    return joined, max(walk.num_frames - ramp, 0)


def nearest(skeleton: Skeleton, first: Poses, second: Poses, margin: int, fps: float) -> tuple[int, int, float]:
    """The frames of two motions between which a change shows least, and the distance: metres, velocities times 0.2 s.

    Only frames at least `margin` from the ends are considered.
    """
    one, two = _features(skeleton, first, fps), _features(skeleton, second, fps)
    one, two = one[margin : len(one) - margin], two[margin : len(two) - margin]
    distance = np.sqrt(((one[:, None] - two[None]) ** 2).mean(-1))
    i, j = np.unravel_index(int(distance.argmin()), distance.shape)
    return int(i) + margin, int(j) + margin, float(distance[i, j])


def _features(skeleton: Skeleton, poses: Poses, fps: float) -> np.ndarray:
    rotations, positions = global_pose(skeleton, poses.quaternions, poses.root)
    yaw = smooth(yaw_of(rotations[:, 0]), 8.0)
    joints = positions - poses.root[:, None] * np.array([1.0, 0.0, 1.0])
    local = (yaw_matrix(-yaw)[:, None] @ joints[..., None])[..., 0]
    chosen = [*skeleton.left_foot[:2], *skeleton.right_foot[:2], skeleton.left_hand[0], skeleton.right_hand[0], 0]
    local = local[:, chosen].reshape(len(local), -1)
    return np.concatenate([local, 0.2 * fps * np.gradient(local, axis=0)], axis=-1)
