"""The captures of one split from which derived clips are drawn, grouped by what is done in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from motiongen_ardy.core.skeleton import Skeleton
from motiongen_ardy.data.dataset import Clip
from motiongen_ardy.data.joining import passes, start, stop
from motiongen_ardy.data.poses import Poses, global_pose, poses_of
from motiongen_ardy.data.replant import Replanted

GESTURES = ("wave-", "raise-up-", "bow", "bye", "byebye")
UNFIT_FLAGS = frozenset({"short", "uneven_ground", "root_travel", "fragment"})
# Single clips of many people, each with a different skeleton: nothing is derived from them.
UNFIT_DATASETS = frozenset({"cmu"})
# Feet that count as standing may shift by up to this in the capture, metres.
MAX_SHIFT_M = 0.06


class Unfit(ValueError):
    """Raised when a draw of sources and numbers does not yield a clip; the message is the reason."""


@dataclass(frozen=True)
class Made:
    """A derived clip before it is judged. sources: the first gives its name; spans: (first frame, content, style)."""

    kind: str
    sources: tuple[Clip, ...]
    content: str
    style: str
    motion: Replanted
    spans: tuple[tuple[int, str, str], ...]


@dataclass
class Shelf:
    """The captures of one split to draw from."""

    skeleton: Skeleton
    fps: float
    clips: Sequence[Clip]
    rng: np.random.Generator
    cache: dict[str, Poses] = field(default_factory=dict)

    def __post_init__(self) -> None:
        good = [clip for clip in self.clips if not set(clip.flags) & UNFIT_FLAGS and clip.dataset not in UNFIT_DATASETS]
        self.walks = [clip for clip in good if clip.content == "walk" and clip.num_frames >= 50]
        self.runs = [clip for clip in good if clip.content in ("run", "dash") and clip.num_frames >= 40]
        self.turns = [clip for clip in good if clip.content.startswith("walk-turn")]
        self.gestures = [clip for clip in good if clip.content.startswith(GESTURES) and 40 <= clip.num_frames <= 150]
        self.stands = [clip for clip in good if clip.content in ("stand", "idle") and clip.num_frames >= 44]

    def poses(self, clip: Clip) -> Poses:
        if clip.id not in self.cache:
            self.cache[clip.id] = poses_of(clip, self.skeleton, self.fps)
        return self.cache[clip.id]

    def pick(self, clips: Sequence[Clip], style: str = "") -> Clip:
        fitting = [clip for clip in clips if clip.style == style] if style else list(clips)
        if not fitting:
            raise Unfit("no source of the style")
        return fitting[int(self.rng.integers(len(fitting)))]

    def moving(self, runs: float = 0.25) -> Clip:
        return self.pick(self.runs if self.rng.random() < runs and self.runs else self.walks)

    def standing(self, style: str) -> tuple[Clip, Poses]:
        """One to four seconds of standing, in the given style, or plain if there is none in that style."""
        styles = {clip.style for clip in self.stands}
        wanted = style if style in styles and style != "normal" else "normal" if self.rng.random() < 0.6 else "none"
        clip = self.pick(self.stands, wanted if wanted in styles else "")
        poses = self.poses(clip)
        length = min(poses.num_frames, int(self.rng.integers(40, 92)))
        first = int(self.rng.integers(poses.num_frames - length + 1))
        toes = global_pose(
            self.skeleton, poses.quaternions[first : first + length], poses.root[first : first + length]
        )[1]
        toes = toes[:, [self.skeleton.left_foot[1], self.skeleton.right_foot[1]]]
        if np.linalg.norm(np.ptp(toes, axis=0), axis=-1).max() > MAX_SHIFT_M:
            raise Unfit("standing feet that shift")
        return clip, planted(cut(poses, first, first + length))


def cut(poses: Poses, first: int, end: int) -> Poses:
    return Poses(poses.quaternions[first:end], poses.root[first:end].copy(), poses.contacts[first:end].copy())


def planted(poses: Poses) -> Poses:
    """The same motion with both feet marked as standing throughout."""
    return Poses(poses.quaternions, poses.root, np.ones_like(poses.contacts))


def moving_content(clip: Clip) -> str:
    return "run" if clip.content == "dash" else clip.content


def begun(shelf: Shelf, clip: Clip, standing: Poses, poses: Poses) -> tuple[Poses, int]:
    """The raw motion from standing into the moving clip, and its first changed frame."""
    found = [entry for entry in passes(shelf.skeleton, poses) if entry.frame < poses.num_frames - 30]
    if not found:
        raise Unfit("no step to start with")
    at = found[int(shelf.rng.integers(max(1, len(found) // 2)))]
    ramp = int(shelf.rng.integers(11, 18)) if clip.content == "walk" else int(shelf.rng.integers(11, 19))
    return start(shelf.skeleton, standing, poses, at, ramp)


def ended(shelf: Shelf, clip: Clip, poses: Poses, standing: Poses, earliest: int) -> tuple[Poses, int]:
    """The raw motion that stops into standing, not before frame `earliest`, and its first frame of slowing."""
    found = [entry for entry in passes(shelf.skeleton, poses) if entry.frame > max(earliest, 14)]
    if not found:
        raise Unfit("no step to stop with")
    at = found[int(shelf.rng.integers(len(found)))]
    ramp = int(shelf.rng.integers(11, 18)) if clip.content == "walk" else int(shelf.rng.integers(11, 19))
    return stop(shelf.skeleton, poses, standing, at, ramp)


def turning_allowed(clip: Clip, side: str) -> bool:
    """Whether a turn to a side may be derived from a clip: one combination is reserved for the test."""
    return not (clip.style == "exhausted" and side == "left")
