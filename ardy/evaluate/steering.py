"""A velocity as a root trajectory, as the server lays it under each window; a parity test holds the two equal."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from ardy.constraint import Targets
from ardy.evaluate.take import Steer

_CHANGE_S = 0.3


def add_steering(
    targets: Targets, steer: Steer, first_frame: int, horizon: int, root: Tensor, heading: float, fps: int
) -> None:
    """Put the trajectory of frames first_frame .. first_frame + horizon - 1 under the targets that there are.

    root: (K, 2) ground positions in metres of the frames before first_frame, at least one; heading: radians, of the
    last of them. What the targets already ask of these frames holds.
    """
    count = min(first_frame + horizon, steer.frame + steer.hold_frames) - first_frame
    if count <= 0:
        return
    last = root[-1].double().numpy()
    speed = (last - root[-2].double().numpy()) * fps if len(root) > 1 else np.zeros(2)
    change = np.minimum(np.arange(1, count + 1) / (_CHANGE_S * fps), 1.0)[:, None]
    ground = last + np.cumsum(speed + (np.array([steer.x, steer.z]) - speed) * change, axis=0) / fps
    angles = None
    if steer.heading is not None:
        turn = math.remainder(steer.heading - heading, math.tau)
        angles = torch.from_numpy((heading + turn * change[:, 0]).astype(np.float32))
    path = Targets(targets.skeleton)
    path.add_root(range(first_frame, first_frame + count), torch.from_numpy(ground.astype(np.float32)), angles)
    targets.ground = path.ground | targets.ground
    targets.heading = path.heading | targets.heading
