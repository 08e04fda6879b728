"""One entry for what is corrected on a finished window before its frames are committed."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import RELEASED_PATCH
from motiongen_ardy.model.sampling.cleanup import clean_feet
from motiongen_ardy.model.sampling.facing import face_root
from motiongen_ardy.model.sampling.joins import HISTORY_FRAMES, join_tokens
from motiongen_ardy.model.sampling.joint_goals import joint_goals
from motiongen_ardy.model.sampling.knees import hinge_knees
from motiongen_ardy.model.sampling.options import SamplingOptions
from motiongen_ardy.model.sampling.pose import Poses
from motiongen_ardy.model.sampling.reach import reach_joints
from motiongen_ardy.model.sampling.seams import settle_seam


def correct_window(
    layout: Representation,
    history: Tensor,
    new: Tensor,
    goals: tuple[Tensor, Tensor] | None,
    options: SamplingOptions,
    patch: int = RELEASED_PATCH,
) -> Tensor:
    """The new frames (B, G, D) of B rows with their feet in place and their joints on their goals, as options say.

    history: (B, H, D), of which the last two frames count, H 0 where a motion begins; new: (B, G, D); both normalised,
    in the world frame. goals: observed features (B, G, D), normalised, in the world frame, and their mask, as
    `Targets.observe` makes them; None for none. patch: frames of a token. Where nothing is to be corrected
    the new frames come back as they are.
    Raises ConfigError for a skeleton whose legs have more than two bones.
    """
    if not options.corrects or not new.shape[1]:
        return new
    history, frames = layout.denormalize(history[:, -HISTORY_FRAMES:]), layout.denormalize(new)
    asked = None if goals is None else joint_goals(layout, *goals)
    if options.join_tokens:
        none = torch.zeros(new.shape[:2], dtype=torch.bool, device=new.device)
        held = none if asked is None else asked.root_met(frames[..., layout.root_position_block])
        frames = hinge_knees(layout, frames)
        frames = settle_seam(layout, history, frames, options.joins)
        frames = join_tokens(layout, history, frames, options.joins, held, patch)
    goes_on = bool(history.shape[1])
    before = history[:, -1:] if goes_on else frames[:, :1]
    natural = torch.cat([before, frames], dim=1)
    poses = Poses(layout, natural)
    pinned = torch.zeros(*natural.shape[:2], 2, dtype=torch.bool, device=new.device)
    height_held = pinned[..., 0]
    if options.face_root:
        face_root(poses, natural[..., layout.heading_block])
    if asked is not None:
        asked = asked.after_history(goes_on)
        height_held = asked.has_height
        if options.reach_joints and asked.any:
            pinned = reach_joints(poses, asked, options.reach, goes_on)
    if options.clean_feet:
        clean_feet(poses, options.feet, pinned, height_held)
    return layout.normalize(poses.features(natural))[:, 1:]
