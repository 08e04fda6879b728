"""A velocity as a root trajectory, as the server lays it under each window; a parity test holds the two equal."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.evaluate.take import Steer

STATE_FRAMES = 4
SLOWING_FRAMES = 16
_ACCELERATION_M_S2 = 2.2
_TURN_RAD_S = 2.6
_SHORTEST_S = 0.3
_WALK_M_S = 0.3


class Lead(NamedTuple):
    """The root of consecutive frames. ground: (K, 2) metres; heading: (K) radians, None where any will do."""

    ground: np.ndarray
    heading: np.ndarray | None


def lead_by(steer: Steer, first_frame: int, horizon: int, root: np.ndarray, heading: float, fps: int) -> Lead | None:
    """The trajectory of the frames first_frame .. first_frame + horizon - 1; None where the velocity has run out.

    root: (K, 2) ground positions in metres of the frames before first_frame, at least one; heading: radians, of the
    last of them.
    """
    asked = np.array([steer.x, steer.z])
    pace = float(np.hypot(*asked))
    slowing = SLOWING_FRAMES if pace > 0.0 else 0
    held = steer.frame + steer.hold_frames - first_frame
    count = min(horizon, held + slowing)
    if count <= 0:
        return None
    recent = root[-STATE_FRAMES:].astype(np.float64)
    before = (recent[-1] - recent[0]) * (fps / max(1, len(recent) - 1))
    facing = math.atan2(*asked) if steer.heading is None and pace > _WALK_M_S else steer.heading
    turn = 0.0 if facing is None else math.remainder(facing - heading, math.tau)
    change = asked - before
    change_s = max(_SHORTEST_S, float(np.hypot(*change)) / _ACCELERATION_M_S2)
    turn_s = max(_SHORTEST_S, abs(turn) / _TURN_RAD_S)
    late_s = 0.0
    if steer.heading is None and abs(turn) > math.pi / 2:
        # Half of the turn is done when the way back begins: the one waits for the other.
        still = np.clip(-before @ change / max(float(change @ change), 1e-9), 0.0, 1.0)
        late_s = turn_s / 2 - change_s * float(still)
    time = np.arange(1, count + 1) / fps
    speed = before + np.clip((time - max(0.0, late_s)) / change_s, 0.0, 1.0)[:, None] * change
    if count > max(0, held):
        speed = _slowed(speed, max(0, held), held + slowing, before)
    headings = None
    if facing is not None:
        headings = heading + turn * np.clip((time - max(0.0, -late_s)) / turn_s, 0.0, 1.0)
    return Lead(recent[-1] + np.cumsum(speed, axis=0) / fps, headings)


def _slowed(speed: np.ndarray, held: int, still: int, before: np.ndarray) -> np.ndarray:
    """Speeds (K, 2) that come from frame `held` on to a stand at frame `still`; before: of frame -1."""
    last = speed[held - 1] if held else before
    share = np.clip(1.0 - np.arange(1, len(speed) - held + 1) / (still - held), 0.0, 1.0)
    return np.concatenate([speed[:held], last * share[:, None]])


def add_lead(targets: Targets, lead: Lead, first_frame: int, stride: int) -> None:
    """Put a trajectory under the targets that there are; what they already ask of its frames holds.

    stride: one frame in so many is asked for, the last among them, and the root may sway between.
    """
    rows = list(range(len(lead.ground) - 1, -1, -stride))[::-1]
    frames = [first_frame + row for row in rows]
    headings = None if lead.heading is None else torch.from_numpy(lead.heading[rows].astype(np.float32))
    path = Targets(targets.skeleton)
    path.add_waypoints(frames, _single(lead.ground[rows]), headings)
    targets.ground = path.ground | targets.ground
    targets.heading = path.heading | targets.heading
    if stride > 1:
        targets.planned.update(frames)


def _single(values: np.ndarray) -> Tensor:
    return torch.from_numpy(values.astype(np.float32))
