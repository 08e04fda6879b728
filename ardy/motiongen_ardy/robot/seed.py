"""Sessions that start from a robot's state: measured joint states -> the history of a window."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import RELEASED_PATCH
from motiongen_ardy.robot.g1 import RobotError, check_qpos, load_g1, qpos_to_motion
from motiongen_ardy.robot.trajectory import continuous_signs, resample_qpos


def history_from_qpos(
    layout: Representation, qpos: Tensor, rate_hz: float, max_frames: int | None = None, patch: int = RELEASED_PATCH
) -> Tensor:
    """Normalised features (H, D) in the world frame, H a multiple of `patch`, from measured qpos (T, 36) at rate_hz.

    The last row is the last frame of the history, so that generation continues from now; earlier frames are sampled at
    the model's frame rate, as many whole tokens as there are, at most max_frames. Angles are taken as measured.
    Raises RobotError for a model with another skeleton, for invalid qpos, and for less than one token of state.
    """
    check_qpos(qpos)
    if layout.skeleton is not load_g1().skeleton and layout.skeleton.joint_names != load_g1().skeleton.joint_names:
        raise RobotError(f"the model's skeleton is {layout.skeleton.name}; qpos is of {load_g1().skeleton.name}")
    newest_first = qpos.double().flip(0)
    newest_first = torch.cat([newest_first[:, :3], continuous_signs(newest_first[:, 3:7]), newest_first[:, 7:]], dim=1)
    frames = resample_qpos(newest_first, rate_hz, layout.fps)
    available = len(frames) if max_frames is None else min(len(frames), max_frames)
    length = available // patch * patch
    if length <= 0:
        raise RobotError(
            f"{len(qpos)} rows at {rate_hz:g} Hz are {len(frames)} frames at the model's {layout.fps} a second"
            f"{'' if max_frames is None else f', of which {max_frames} may be used'}; give {patch} or more"
        )
    motion = qpos_to_motion(frames[:length].flip(0), layout.fps)
    like = layout.feature_stats.mean
    features = layout.features(motion.local_rotations[None].to(like), motion.root_positions[None].to(like))
    return layout.normalize(features)[0]
