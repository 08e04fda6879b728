"""Recipes of derived clips that take another path than their capture: bends, sidesteps, turns on the spot, speeds."""

from __future__ import annotations

import math

import numpy as np

from motiongen_ardy.data.dataset import Clip
from motiongen_ardy.data.poses import smooth, smoothstep
from motiongen_ardy.data.shelf import Made, Shelf, Unfit, begun, cut, ended, moving_content
from motiongen_ardy.data.warp import warp, way_of

# What people manage while walking and on the spot, radians a second.
MAX_TURN_RATE = 2.2
# A step to the side goes no further than this, metres.
MAX_ACROSS_M = 0.45


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
    motion = warp(shelf.skeleton, raw, shelf.fps, zero, travel=zero, stride=zero + stride, flatten=slow)
    what = moving_content(clip)
    if what in ("walk", "run"):
        what += "-slow" if factor < 0.82 else "-fast" if factor > 1.18 else ""
    spans = [(0, what, clip.style)]
    if what == moving_content(clip):
        spans = [
            (int(p.start / pace), p.content, clip.style) for p in clip.segments if p.content.startswith("walk")
        ] or spans
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
    motion = warp(shelf.skeleton, poses, fps, turn, travel=turn, stride=stride, flatten=0.7 * (1 - stride))
    side = "left" if sign > 0 else "right"
    if kind in ("weave", "random"):
        return Made(kind, (clip,), f"{what}-weaving", clip.style, motion, ((0, f"{what}-weaving", clip.style),))
    content = (
        f"{what}-curve-{side}" if kind == "arc" else f"turn-around-{side}" if kind == "uturn" else f"{what}-turn-{side}"
    )
    spans = (
        (0, what, clip.style),
        (max(told - 2, 1), content, clip.style),
        (min(end + 2, frames - 1), what, clip.style),
    )
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
    motion = warp(
        shelf.skeleton,
        poses,
        fps,
        zero,
        travel=away + drift,
        stride=zero + stride,
        flatten=flatten * still_part,
        widen=widen * still_part,
    )
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
    motion = warp(shelf.skeleton, poses, fps, turn, travel=turn, stride=zero, flatten=0.9 * moving)
    content = f"turn-on-spot-{'left' if sign > 0 else 'right'}"
    # The caption of standing starts when the turn is done.
    spans = ((0, still.content, still.style), (told, content, clip.style), (stop_at, other.content, other.style))
    return Made("on-the-spot", (clip, still, other), content, clip.style, motion, spans)
