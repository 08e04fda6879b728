"""Recipes of derived clips that begin or end with standing, and of changes from one action to another."""

from __future__ import annotations

import math

import numpy as np

from motiongen_ardy.data.dataset import Clip
from motiongen_ardy.data.joining import join, nearest
from motiongen_ardy.data.poses import smooth, smoothstep
from motiongen_ardy.data.replant import replant
from motiongen_ardy.data.shelf import Made, Shelf, Unfit, begun, cut, ended, moving_content, planted, turning_allowed
from motiongen_ardy.data.warp import warp


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
        return Made(
            "stop",
            sources,
            what,
            clip.style,
            replant(skeleton, raw),
            ((0, what, clip.style), (told, still.content, still.style)),
        )
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
            motion = warp(skeleton, raw, shelf.fps, turn, travel=turn, stride=stride)
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
            second = shelf.pick(
                pool, first.style if rng.random() < 0.5 and any(c.style == first.style for c in pool) else ""
            )
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
