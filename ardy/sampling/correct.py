"""One entry for what is corrected on a finished window before its frames are committed."""

from __future__ import annotations

import torch
from torch import Tensor

from ardy.representation import Representation
from ardy.sampling.cleanup import clean_feet
from ardy.sampling.facing import face_root
from ardy.sampling.joins import join_tokens
from ardy.sampling.joint_goals import joint_goals
from ardy.sampling.options import SamplingOptions
from ardy.sampling.pose import Poses
from ardy.sampling.reach import reach_joints


def correct_window(
    layout: Representation,
    history: Tensor,
    new: Tensor,
    goals: tuple[Tensor, Tensor] | None,
    options: SamplingOptions,
) -> Tensor:
    """The new frames (B, G, D) of B rows with their feet in place and their joints on their goals, as options say.

    history: (B, H, D), of which the last frame counts, H 0 where a motion begins; new: (B, G, D); both normalised, in
    the world frame. goals: observed features (B, G, D), normalised, in the world frame, and their mask, as
    `Targets.observe` makes them; None for none. Where nothing is to be corrected the new frames come back as
    they are. Raises ConfigError for a skeleton whose legs have more than two bones.
    """
    if not options.corrects or not new.shape[1]:
        return new
    before = history[:, -1:] if history.shape[1] else new[:, :1]
    natural = layout.denormalize(torch.cat([before, new], dim=1))
    poses = Poses(layout, natural)
    pinned = torch.zeros(*natural.shape[:2], 2, dtype=torch.bool, device=new.device)
    root_held = height_held = pinned[..., 0]
    if goals is not None:
        asked = joint_goals(layout, *goals)
        root_held, height_held = asked.root_met(poses.root), asked.has_height
    if options.face_root:
        face_root(poses, natural[..., layout.heading_block])
    if options.join_tokens:
        join_tokens(poses, options.joins, root_held)
    if options.reach_joints and goals is not None and asked.any:
        pinned = reach_joints(poses, asked, options.reach)
    if options.clean_feet:
        clean_feet(poses, options.feet, pinned, height_held)
    return layout.normalize(poses.features(natural))[:, 1:]
