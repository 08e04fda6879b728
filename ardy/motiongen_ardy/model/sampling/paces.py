"""Paces: where a planned root moves at a speed that does not fit the prompt, a gait's prompt is used instead.

A character whose prompt is standing, but which is to be somewhere else in two seconds, has to walk there; with the
prompt for standing, the network makes it glide. The usual speeds of a prompt are those of the captions that the model
was trained on; the gaits are those of velocities.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from torch import Tensor

from motiongen_ardy.core.constraint import Floats, Targets
from motiongen_ardy.locomotion.gait import gait_at, quarter_of
from motiongen_ardy.model.sampling.options import PaceOptions

SPEED_FRAMES = 10  # frames over which a speed is averaged: about a step


@dataclass(frozen=True, eq=False)
class PromptPaces:
    """Usual speeds of captions, and the gaits. All on the CPU.

    mean: (W), of the captions' unit vectors.
    directions: (N, W), unit vectors from it to the captions.
    speeds: (N, 2), metres a second that hardly any frame of the caption is below, and above.
    threshold: the greatest distance (one minus cosine) of a prompt to its nearest caption at which its speed is known.
    gaits: (K, W), texts.
    from_mps: (K), metres a second from which each is used.
    quarters: (K), the direction of each in quarter turns to the left of the facing, 0 to 3.
    """

    mean: Tensor
    directions: Tensor
    speeds: Tensor
    threshold: float
    gaits: Tensor
    from_mps: Tensor
    quarters: Tensor

    def of(self, text: Tensor) -> tuple[float, float] | None:
        """Least and greatest usual speed of a prompt (W), metres a second; None if it is not similar to any caption."""
        offset = text / text.norm().clamp(min=1e-12) - self.mean
        cosines = self.directions @ (offset / offset.norm().clamp(min=1e-12))
        nearest = int(cosines.argmax())
        if 1 - float(cosines[nearest]) > self.threshold:
            return None
        slow, fast = self.speeds[nearest].tolist()
        return slow, fast

    def gait(self, speed: float, angle: float) -> Tensor | None:
        """The text (W) of the gait for a speed and a direction, in radians to the left of the facing."""
        rows = zip(self.from_mps.tolist(), self.quarters.int().tolist(), self.gaits, strict=True)
        known = [_GaitText(from_mps, quarter, text) for from_mps, quarter, text in rows]
        gait = gait_at(known, speed, quarter_of(angle))
        return None if gait is None else gait.text


class _GaitText(NamedTuple):
    """A gait with its text (W). quarter: its direction in quarter turns to the left of the facing, 0 to 3."""

    from_mps: float
    quarter: int
    text: Tensor


class Told(NamedTuple):
    """The text that a window is given. text: (n, W); led_to: the frame from which the prompt itself applies again, and
    at which the window is to end; None if the same text applies throughout.
    """

    text: Tensor
    led_to: int | None = None


def told_text(
    paces: PromptPaces | None,
    text: Tensor,
    targets: Targets | None,
    position: tuple[float, float],
    window: range,
    *,
    fps: int,
    options: PaceOptions,
) -> Told:
    """The text (n, W) for a window of new frames: `text`, or that of a gait if the targets go at a pace that the motion
    of `text` does not have.

    targets: as planned for the window; position: x and z in metres of the root at the frame before it.
    """
    if paces is None or targets is None or len(text) != 1 or not bool(text.any()):
        return Told(text)
    ground = {frame: place for frame, place in targets.ground.items() if frame >= window.start}
    usual = paces.of(text[0].cpu()) if ground else None
    if usual is None:
        return Told(text)
    path = _path(ground, np.array(position), window.start, min(window.stop, max(ground) + 1))
    speed = _speeds(path) * fps
    slow, fast = usual
    if speed.max() > options.above_share * fast + options.above_m_s:
        moving = np.flatnonzero(speed > fast + options.above_m_s)
        led = speed[: int(moving[-1]) + 1]
    elif speed.max() < options.below_share * slow:
        led = speed
    else:
        return Told(text)
    if len(led) < options.least_frames:
        return Told(text)
    pace = float(led[led >= 0.5 * led.max()].mean())
    gait = paces.gait(pace, _aside(targets, path[: len(led) + 1], window.start))
    if gait is None:
        return Told(text)
    led_to = window.start + len(led)
    return Told(gait[None].to(text), None if led_to >= window.stop else led_to)


def _path(ground: Mapping[int, Floats], position: np.ndarray, first: int, end: int) -> np.ndarray:
    """Ground positions (end - first + 1, 2) of the frames from first - 1 on, linear between known ones."""
    frames = sorted(ground)
    known = np.array([position, *(ground[frame] for frame in frames)])
    at = np.arange(first - 1, end)
    return np.stack([np.interp(at, [first - 1, *frames], known[:, axis]) for axis in (0, 1)], axis=1)


def _speeds(path: np.ndarray) -> np.ndarray:
    """Speeds (T), metres a frame, of a path (T + 1, 2) at all its frames but the first, averaged over SPEED_FRAMES."""
    count = len(path) - 1
    first = np.clip(np.arange(count) - SPEED_FRAMES // 2, 0, max(0, count - SPEED_FRAMES))
    last = np.minimum(first + SPEED_FRAMES, count)
    speeds: np.ndarray = np.hypot(*(path[last] - path[first]).T) / (last - first)
    return speeds


def _aside(targets: Targets, path: np.ndarray, first: int) -> float:
    """The direction, in radians to the left of the facing, in which a body moves along a path (T + 1, 2); 0 if its
    heading is free. The path's first point is at the frame before `first`.
    """
    facing = np.zeros(2)
    for frame, heading in targets.heading.items():
        row = frame - first + 1
        if 0 < row < len(path):
            way = path[row] - path[max(0, row - SPEED_FRAMES)]
            cosine, sine = heading.tolist()
            facing += (way[1] * cosine + way[0] * sine, way[0] * cosine - way[1] * sine)
    return math.atan2(facing[1], facing[0]) if facing.any() else 0.0
