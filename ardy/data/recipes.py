"""Derived clips of every kind, made of captures: what is drawn at random, which captions are true of which frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import torch

from ardy.data.captions import mirror_content, paraphrases
from ardy.data.dataset import Clip, Segment
from ardy.data.joining import join, nearest, passes, start, stop
from ardy.data.poses import Poses, global_pose, poses_of, smooth, smoothstep
from ardy.data.quality import Quality, quality
from ardy.data.replant import Replanted, replant
from ardy.data.warp import warp, way_of
from ardy.skeleton import Skeleton

# What people manage: turning while walking, and on the spot, radians a second.
MAX_TURN_RATE = 2.2
# Feet that are taken to stand may have shifted by this in the capture, metres.
MAX_SHIFT_M = 0.06
# A step to the side goes no further than this, and feet do not cross by more than that, metres.
MAX_ACROSS_M = 0.45
MAX_CROSSING_M = 0.08
GESTURES = ("wave-", "raise-up-", "bow", "bye", "byebye")


class Unfit(ValueError):
    """Raised when a draw of sources and numbers gives no clip; the message is the reason."""


@dataclass(frozen=True)
class Made:
    """A derived clip before it is judged. sources: the first is the one named; spans: (first frame, content, style)."""

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
        good = [clip for clip in self.clips if not set(clip.flags) & {"short", "uneven_ground", "root_travel", "fragment"}]
        good = [clip for clip in good if clip.dataset.startswith("dataset")  or clip.content == "idle"]
        self.walks = [clip for clip in good if clip.content == "walk" and clip.num_frames >= 50]
        self.runs = [clip for clip in good if clip.content in ("run", "dash") and clip.num_frames >= 40]
        self.turns = [clip for clip in good if clip.content.startswith("walk-turn")]
        self.gestures = [
            clip for clip in good if clip.content.startswith(GESTURES) and 40 <= clip.num_frames <= 150
        ]
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
        """One to four seconds of standing: in the style, or plain where the style has none."""
        styles = {clip.style for clip in self.stands}
        wanted = style if style in styles and style != "normal" else "normal" if self.rng.random() < 0.6 else "none"
        clip = self.pick(self.stands, wanted if wanted in styles else "")
        poses = self.poses(clip)
        length = min(poses.num_frames, int(self.rng.integers(40, 92)))
        first = int(self.rng.integers(poses.num_frames - length + 1))
        toes = global_pose(self.skeleton, poses.quaternions[first : first + length], poses.root[first : first + length])[1]
        toes = toes[:, [self.skeleton.left_foot[1], self.skeleton.right_foot[1]]]
        if np.linalg.norm(np.ptp(toes, axis=0), axis=-1).max() > MAX_SHIFT_M:
            raise Unfit("standing feet that shift")
        return clip, planted(cut(poses, first, first + length))


def cut(poses: Poses, first: int, end: int) -> Poses:
    return Poses(poses.quaternions[first:end], poses.root[first:end].copy(), poses.contacts[first:end].copy())


def planted(poses: Poses) -> Poses:
    """The same motion with both feet taken to stand throughout."""
    return Poses(poses.quaternions, poses.root, np.ones_like(poses.contacts))


def moving_content(clip: Clip) -> str:
    return "run" if clip.content == "dash" else clip.content


def begun(shelf: Shelf, clip: Clip, standing: Poses, poses: Poses) -> tuple[Poses, int]:
    """The raw motion from standing into the moving clip, and its first frame of change."""
    found = [entry for entry in passes(shelf.skeleton, poses) if entry.frame < poses.num_frames - 30]
    if not found:
        raise Unfit("no step to start with")
    at = found[int(shelf.rng.integers(max(1, len(found) // 2)))]
    ramp = int(shelf.rng.integers(11, 18)) if clip.content == "walk" else int(shelf.rng.integers(11, 19))
    return start(shelf.skeleton, standing, poses, at, ramp)


def ended(shelf: Shelf, clip: Clip, poses: Poses, standing: Poses, earliest: int) -> tuple[Poses, int]:
    """The raw motion that stops into standing not before frame `earliest`, and its first frame of slowing."""
    found = [entry for entry in passes(shelf.skeleton, poses) if entry.frame > max(earliest, 14)]
    if not found:
        raise Unfit("no step to stop with")
    at = found[int(shelf.rng.integers(len(found)))]
    ramp = int(shelf.rng.integers(11, 18)) if clip.content == "walk" else int(shelf.rng.integers(11, 19))
    return stop(shelf.skeleton, poses, standing, at, ramp)


def turning_allowed(clip: Clip, side: str) -> bool:
    """Whether a turn to a side may be made of a clip: a combination kept for the test may not."""
    return not (clip.style == "exhausted" and side == "left")


def start_or_stop(shelf: Shelf) -> Made:
    rng, skeleton = shelf.rng, shelf.skeleton
    clip = shelf.moving(0.3)
    what = moving_content(clip)
    still, standing = shelf.standing(clip.style)
    poses = shelf.poses(clip)
    kind = rng.choice(["start", "stop", "both"], p=[0.5, 0.25, 0.25])
    sources: tuple[Clip, ...] = (clip, still)
    spans: list[tuple[int, str, str]] = []
    if kind == "stop":
        raw, told = ended(shelf, clip, poses, standing, 25)
        return Made("stop", sources, what, clip.style, replant(skeleton, raw), ((0, what, clip.style), (told, still.content, still.style)))
    raw, told = begun(shelf, clip, standing, poses)
    spans = [(0, still.content, still.style), (told, what, clip.style)]
    last = raw.num_frames
    if kind == "both":
        other, after = shelf.standing(clip.style)
        raw, last = ended(shelf, clip, raw, after, told + 30)
        sources += (other,)
    if what == "walk" and rng.random() < 0.45:
        angle = float(rng.uniform(30, 180)) * (1 if rng.random() < 0.5 else -1)
        side = "left" if angle > 0 else "right"
        if not turning_allowed(clip, side):
            angle, side = -angle, "right"
        length = int(abs(angle) / 95 * shelf.fps) + 10
        if told + length + 10 < last:
            turn = smoothstep((np.arange(raw.num_frames) - told - 2) / length) * math.radians(angle)
            slow = np.abs(np.gradient(turn)) * shelf.fps / 2.5
            stride = 1 - 0.6 * np.clip(smooth(slow, 2.0), 0, 1)
            motion = warp(skeleton, raw, shelf.fps, turn, turn, stride)
            spans = [spans[0], (told, f"start-turn-{side}", clip.style), (told + length, what, clip.style)]
            if kind == "both":
                spans.append((last, other.content, other.style))
            return Made("start-turn", sources, f"start-turn-{side}", clip.style, motion, tuple(spans))
    if kind == "both":
        spans.append((last, other.content, other.style))
    return Made(str(kind), sources, what, clip.style, replant(skeleton, raw), tuple(spans))


def transition(shelf: Shelf) -> Made:
    rng, skeleton = shelf.rng, shelf.skeleton
    draw = rng.random()
    if draw < 0.5:
        first = shelf.moving(0.4)
        pool = shelf.runs if first.content == "walk" and rng.random() < 0.6 else shelf.walks
        one = shelf.poses(first)
        best: tuple[float, int, int, Clip] | None = None
        for _ in range(8):
            second = shelf.pick(pool, first.style if rng.random() < 0.5 and any(c.style == first.style for c in pool) else "")
            if second.id == first.id:
                continue
            two = shelf.poses(second)
            i, j, distance = nearest(skeleton, cut(one, 15, one.num_frames), two, 8, shelf.fps)
            if j < two.num_frames - 30 and (best is None or distance < best[0]):
                best = (distance, i + 15, j, second)
        if best is None or best[0] > 0.25:
            raise Unfit("no two poses near enough")
        _, i, j, second = best
        two = shelf.poses(second)
        half = 5
        raw = join(skeleton, cut(one, 0, i + half), cut(two, j - half, two.num_frames), 2 * half)
        spans = ((0, moving_content(first), first.style), (i - half, moving_content(second), second.style))
        return Made("change", (first, second), moving_content(second), second.style, replant(skeleton, raw), spans)
    if draw < 0.8:
        clip = shelf.moving(0.2)
        what = moving_content(clip)
        styles = {entry.style for entry in shelf.gestures}
        gesture = shelf.pick(shelf.gestures, clip.style if clip.style in styles and rng.random() < 0.7 else "")
        acted = planted(shelf.poses(gesture))
        if rng.random() < 0.6:
            poses = shelf.poses(clip)
            raw, told = ended(shelf, clip, cut(poses, 0, min(poses.num_frames, 110)), acted, 20)
            spans2: tuple[tuple[int, str, str], ...] = ((0, what, clip.style), (told, gesture.content, gesture.style))
            if rng.random() < 0.6:
                later = shelf.pick(shelf.walks, clip.style) if what == "walk" else shelf.pick(shelf.walks)
                raw, again = begun(shelf, later, raw, cut(shelf.poses(later), 0, 110))
                spans2 += ((again, "walk", later.style),)
                sources = (clip, gesture, later)
                return Made("gesture-between", sources, "walk", later.style, replant(skeleton, raw), spans2)
            return Made("to-gesture", (clip, gesture), gesture.content, gesture.style, replant(skeleton, raw), spans2)
        raw, told = begun(shelf, clip, acted, shelf.poses(clip))
        spans2 = ((0, gesture.content, gesture.style), (told, what, clip.style))
        return Made("from-gesture", (clip, gesture), what, clip.style, replant(skeleton, raw), spans2)
    gesture = shelf.pick(shelf.gestures)
    still, standing = shelf.standing(gesture.style)
    acted = planted(shelf.poses(gesture))
    raw = join(skeleton, standing, acted, 10, (0, 1))
    raw.contacts[:] = True
    told = standing.num_frames - 10
    spans2 = ((0, still.content, still.style), (told, gesture.content, gesture.style))
    return Made("stand-gesture", (gesture, still), gesture.content, gesture.style, replant(skeleton, raw), spans2)


def speed_change(shelf: Shelf) -> Made:
    rng = shelf.rng
    clip = shelf.pick([*shelf.walks, *shelf.turns[::3], *shelf.runs[::2]])
    poses = shelf.poses(clip)
    pace, stride = float(rng.uniform(0.8, 1.22)), float(rng.uniform(0.78, 1.2))
    if (pace > 1) != (stride > 1) and rng.random() < 0.7:
        stride = 2 - stride
    times = np.arange(0, poses.num_frames - 1, pace)
    raw = poses.at(times)
    zero = np.zeros(raw.num_frames)
    factor = pace * stride
    slow = np.full(raw.num_frames, max(0.0, 0.8 * (1 - stride)))
    motion = warp(shelf.skeleton, raw, shelf.fps, zero, zero, zero + stride, slow)
    what = moving_content(clip)
    if what in ("walk", "run"):
        what += "-slow" if factor < 0.82 else "-fast" if factor > 1.18 else ""
    spans = [(0, what, clip.style)]
    if what == moving_content(clip):
        spans = [(int(p.start / pace), p.content, clip.style) for p in clip.segments if p.content.startswith("walk")] or spans
    return Made("speed", (clip,), what, clip.style, motion, tuple(spans))


def bend(shelf: Shelf) -> Made:
    rng, fps = shelf.rng, shelf.fps
    clip = shelf.moving(0.15)
    what = moving_content(clip)
    poses = shelf.poses(clip)
    frames = poses.num_frames
    speed = np.linalg.norm(np.gradient(way_of(poses, fps), axis=0), axis=-1) * fps
    usual = float(np.median(speed))
    kind = str(rng.choice(["arc", "weave", "corner", "uturn", "random"], p=[0.35, 0.15, 0.2, 0.15, 0.15]))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    if clip.style == "exhausted":
        sign, kind = -1.0, "arc" if kind in ("weave", "random") else kind
    radius = float(np.exp(rng.uniform(math.log(0.3 if what == "walk" else 1.0), math.log(5.0))))
    rate = np.zeros(frames)
    told, end = 0, frames
    if kind in ("corner", "uturn"):
        angle = math.radians(float(rng.uniform(60, 120) if kind == "corner" else rng.uniform(150, 200)))
        radius = min(radius, 1.2 if what == "walk" else 2.5)
        turn_rate = min(usual / radius, MAX_TURN_RATE)
        length = int(angle / turn_rate * fps)
        if length + 16 > frames:
            raise Unfit("too short for the turn")
        told = int(rng.integers(6, frames - length - 8))
        end = told + length
        rate[told:end] = sign * angle / length * fps
    elif kind == "arc":
        rate[:] = sign * min(usual / radius, MAX_TURN_RATE)
    elif kind == "weave":
        period = float(rng.uniform(2.5, 5)) * fps
        swing = min(usual / radius, 1.4)
        rate = sign * swing * np.sin(2 * np.pi * np.arange(frames) / period)
    else:
        rate = smooth(rng.normal(size=frames), 10.0)
        rate *= min(usual / radius, 1.8) / max(np.abs(rate).max(), 1e-6)
    rate = smooth(rate, 2.5)
    wanted = np.abs(rate) * radius / np.maximum(speed, 0.2) if kind not in ("weave", "random") else np.ones(frames)
    tight = np.abs(rate) > 0.95 * MAX_TURN_RATE
    stride = smooth(np.where(tight, np.clip(wanted, 0.35, 1.0), 1.0), 4.0)
    turn = np.cumsum(rate) / fps
    motion = warp(shelf.skeleton, poses, fps, turn, turn, stride, 0.7 * (1 - stride))
    side = "left" if sign > 0 else "right"
    if kind in ("weave", "random"):
        return Made(kind, (clip,), f"{what}-weaving", clip.style, motion, ((0, f"{what}-weaving", clip.style),))
    content = f"{what}-curve-{side}" if kind == "arc" else f"turn-around-{side}" if kind == "uturn" else f"{what}-turn-{side}"
    spans = ((0, what, clip.style), (max(told - 2, 1), content, clip.style), (min(end + 2, frames - 1), what, clip.style))
    return Made(kind, (clip,), content, clip.style, motion, spans if kind != "arc" else ((0, content, clip.style),))


def strafe(shelf: Shelf) -> Made:
    rng, fps = shelf.rng, shelf.fps
    clip = shelf.pick(shelf.walks)
    poses = shelf.poses(clip)
    spans: list[tuple[int, str, str]] = []
    sources: tuple[Clip, ...] = (clip,)
    told, last = 0, 0
    if rng.random() < 0.45:
        still, standing = shelf.standing(clip.style)
        poses, told = begun(shelf, clip, standing, poses)
        spans.append((0, still.content, still.style))
        sources += (still,)
        if rng.random() < 0.5:
            still, standing = shelf.standing(clip.style)
            poses, last = ended(shelf, clip, poses, standing, told + 30)
            sources += (still,)
    frames = poses.num_frames
    way = way_of(poses, fps)
    speed = np.linalg.norm(np.gradient(way, axis=0), axis=-1) * fps
    usual = float(np.median(speed[speed > 0.3])) if (speed > 0.3).any() else 1.0
    angle = float(rng.choice([30, 45, 60, 90, 90, 120, 135, 180])) + float(rng.uniform(-8, 8))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    if clip.style == "sad" and angle > 105:
        raise Unfit("kept for the test")
    away = math.radians(angle) * sign
    stride = min(1.0, float(rng.uniform(0.3, 1.2 if angle < 70 else 0.9)) / usual)
    stride = min(stride, MAX_ACROSS_M / max(usual * 0.5 * abs(math.sin(away)), 1e-6))
    across = stride * usual * 0.5 * abs(math.sin(away))
    widen = np.full(frames, float(np.clip((across - 0.18) / 2 + 0.02, 0, 0.15)))
    drift = np.zeros(frames)
    if rng.random() < 0.35:
        drift = smooth(rng.normal(size=frames), 14.0)
        drift = np.cumsum(drift / max(np.abs(drift).max(), 1e-6)) * 0.7 / fps
    flatten = np.full(frames, min(0.85, 0.35 * (1 - math.cos(away)) + 0.6 * (1 - stride)))
    still_part = np.ones(frames)
    if told:
        still_part *= smoothstep((np.arange(frames) - told) / 12)
    if last:
        still_part *= 1 - smoothstep((np.arange(frames) - last - 2) / 12)
    zero = np.zeros(frames)
    motion = warp(shelf.skeleton, poses, fps, zero, away + drift, zero + stride, flatten * still_part, widen * still_part)
    side = "left" if sign > 0 else "right"
    content = "walk-back" if angle > 158 else f"walk-back-diagonal-{side}" if angle > 108 else f"walk-sideways-{side}"
    content = content if angle > 67 else f"walk-diagonal-{side}"
    spans.append((told, content, clip.style))
    if last:
        spans.append((last, still.content, still.style))
    return Made("strafe", sources, content, clip.style, motion, tuple(spans))


def on_the_spot(shelf: Shelf) -> Made:
    rng, fps = shelf.rng, shelf.fps
    clip = shelf.pick(shelf.walks)
    still, standing = shelf.standing(clip.style)
    other, after = shelf.standing(clip.style)
    poses, told = begun(shelf, clip, standing, shelf.poses(clip))
    angle = math.radians(float(rng.choice([45, 60, 90, 90, 120, 135, 180, 180])))
    needed = int(angle / math.radians(float(rng.uniform(60, 110))) * fps) + 8
    poses = cut(poses, 0, min(poses.num_frames, told + needed + 32))
    poses, last = ended(shelf, clip, poses, after, told + max(needed - 12, 14))
    sign = -1.0 if rng.random() < 0.5 or clip.style == "exhausted" else 1.0
    frames = poses.num_frames
    stop_at = min(last + 10, frames - 4)
    turn = sign * angle * smoothstep((np.arange(frames) - told - 2) / max(stop_at - told - 2, 8))
    zero = np.zeros(frames)
    moving = smoothstep((np.arange(frames) - told) / 10) * (1 - smoothstep((np.arange(frames) - last - 2) / 10))
    motion = warp(shelf.skeleton, poses, fps, turn, turn, zero, 0.9 * moving)
    content = f"turn-on-spot-{'left' if sign > 0 else 'right'}"
    # The order to stand comes when the turn is done.
    spans = ((0, still.content, still.style), (told, content, clip.style), (stop_at, other.content, other.style))
    return Made("on-the-spot", (clip, still, other), content, clip.style, motion, spans)


RECIPES: dict[str, tuple[Callable[[Shelf], Made], float]] = {
    "start-stop": (start_or_stop, 1.15),
    "transition": (transition, 0.7),
    "bend": (bend, 1.3),
    "strafe": (strafe, 0.5),
    "on-the-spot": (on_the_spot, 0.3),
    "speed": (speed_change, 0.45),
}


def fault(made: Made, figures: Quality, skeleton: Skeleton) -> str:
    """Why a clip is not like a capture, "" if it is. Bounds: the captures' 95th to 99th percentiles."""
    running = any(moving_content(source) == "run" for source in made.sources)
    bounds = {
        "acceleration": (figures.acceleration, 90.0 if running else 66.0),
        "skate_m_s": (figures.skate_m_s, 0.14 if running else 0.1),
        "slowest_ratio": (figures.slowest_ratio, 0.3 if running else 0.08),
        "knee_deg": (figures.knee_deg, 46.0 if running else 33.0),
        "lifted_m": (figures.lifted_m, 0.16 if running else 0.05),
        "drop_m": (float(made.motion.drop_m.max()), 0.11),
        "short_m": (float(made.motion.short_m.max()), 0.02),
    }
    if made.kind == "strafe":
        bounds["crossing_m"] = (crossing(made, skeleton), MAX_CROSSING_M)
    return next((name for name, (value, bound) in bounds.items() if not value <= bound), "")


def crossing(made: Made, skeleton: Skeleton) -> float:
    """How far the left ankle gets to the right of the right one, metres, across the hips."""
    poses = made.motion.poses
    _, positions = global_pose(skeleton, poses.quaternions, poses.root)
    right, left = skeleton.hip_joints
    across = positions[:, left] - positions[:, right]
    across[:, 1] = 0
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    apart = positions[:, skeleton.left_foot[0]] - positions[:, skeleton.right_foot[0]]
    return float(-(apart * across).sum(-1).min())


@lru_cache
def _captions(content: str, style: str) -> tuple[str, ...]:
    return paraphrases(content, style) or paraphrases(content, "none")


def clip_of(made: Made, figures: Quality, number: int) -> Clip:
    """The clip of the set. Its own captions name what follows on what; each segment's are those of its frames."""
    frames = made.motion.poses.num_frames
    edges = [min(max(span[0], 0), frames) for span in made.spans] + [frames]
    parts = [
        Segment(edges[k], edges[k + 1] - edges[k], content, _captions(content, style))
        for k, (_, content, style) in enumerate(made.spans)
        if edges[k + 1] > edges[k]
    ]
    whole = parts[0].captions
    if len(parts) > 1:
        whole = tuple(
            " and then ".join(
                [parts[0].captions[0 if k == 0 else 2 * k % len(parts[0].captions)]]
                + [part.captions[2 * k % len(part.captions)].removeprefix("a person ") for part in parts[1:]]
            )
            for k in range(4)
        )
    first = made.sources[0]
    flags = {flag for source in made.sources for flag in source.flags} - {"cut"}
    turned = mirror_content(made.content) != made.content
    allowed = all(source.mirror_allowed for source in made.sources) and not (turned and first.style == "exhausted")
    return Clip(
        id=f"{first.id}~{made.kind}{number}",
        dataset=first.dataset,
        content=made.content,
        style=made.style,
        split=first.split,
        captions=tuple(dict.fromkeys(whole)),
        segments=tuple(parts) if len(parts) > 1 else (),
        mirror_allowed=allowed,
        derived_from=first.id,
        flags=tuple(sorted(flags | {f"derived-{made.kind}"})),
        figures=figures.rounded(),
        local_rotations=torch.from_numpy(made.motion.poses.quaternions).float(),
        root_positions=torch.from_numpy(made.motion.poses.root).float(),
    )


def make(
    clips: Sequence[Clip], skeleton: Skeleton, fps: float, seed: int, share: float
) -> tuple[list[Clip], dict[str, int]]:
    """Derived clips of one split's captures, `share` of the hours of RECIPES, and what was dropped: counts by reason.

    The same captures, seed and share give the same clips.
    """
    made_clips: list[Clip] = []
    dropped: dict[str, int] = {}
    for place, (name, (recipe, hours)) in enumerate(RECIPES.items()):
        shelf = Shelf(skeleton, fps, clips, np.random.default_rng([seed, place]))
        budget, frames, tries = hours * share * 3600 * fps, 0, 0
        while frames < budget and tries < 60 + budget / 30:
            tries += 1
            try:
                made = recipe(shelf)
                poses = made.motion.poses
                if poses.num_frames < 30:
                    raise Unfit("too short")
            except Unfit as error:
                reason = f"{name}: {error}"
                dropped[reason] = dropped.get(reason, 0) + 1
                continue
            figures = quality(skeleton, poses.quaternions, poses.root, fps)
            if reason := fault(made, figures, skeleton):
                dropped[f"{name}: {reason}"] = dropped.get(f"{name}: {reason}", 0) + 1
                continue
            made_clips.append(clip_of(made, figures, tries))
            frames += poses.num_frames
    return made_clips, dropped
