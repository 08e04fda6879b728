"""All corrections of a finished window, applied before its frames are committed."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.model.config import RELEASED_PATCH
from motiongen_ardy.model.sampling.cleanup import clean_feet
from motiongen_ardy.model.sampling.facing import face_root
from motiongen_ardy.model.sampling.flips import undo_flips
from motiongen_ardy.model.sampling.joins import HISTORY_FRAMES, join_roots, join_rotations
from motiongen_ardy.model.sampling.joint_goals import JointGoals, joint_goals
from motiongen_ardy.model.sampling.knees import hinge_knees
from motiongen_ardy.model.sampling.options import JoinOptions, SamplingOptions
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
    *,
    reaches: bool | None = None,
) -> Tensor:
    """The new frames (B, G, D) of B rows, with feet in place and joints on their goals, as the options say.

    history: (B, H, D), of which only the last two frames are used; H = 0 at the beginning of a motion. new: (B, G, D).
    Both are normalised, in the world frame. goals: observed features (B, G, D) and their mask, as made by
    `Targets.observe`; None: no goals. patch: frames per token. reaches: whether there are goals for more than the root
    on the ground; None: find out, which synchronises with a GPU. If there is nothing to correct, `new` itself is
    returned. Raises ConfigError for a skeleton whose legs have more than two bones.
    """
    if not options.corrects or not new.shape[1]:
        return new
    history, frames = layout.denormalize(history[:, -HISTORY_FRAMES:]), layout.denormalize(new)
    asked = None if goals is None else joint_goals(layout, *goals)
    before, poses = Poses.of(layout, history), Poses.of(layout, frames)
    goes_on = bool(history.shape[1])
    heading = torch.cat([history[:, -1:] if goes_on else frames[:, :1], frames], dim=1)[..., layout.heading_block]
    if options.face_root:
        undo_flips(before.only(-1) if goes_on else poses.only(0), poses, heading)
    if options.join_tokens:
        _join(before, poses, asked, options.joins, patch)
    poses = (before.only(-1) if goes_on else poses.only(0)).then(poses)
    pinned = torch.zeros(*heading.shape[:2], 2, dtype=torch.bool, device=new.device)
    height_held = pinned[..., 0]
    if options.face_root:
        face_root(poses, heading)
    if asked is not None:
        asked = asked.after_history(goes_on)
        height_held = asked.has_height
        if options.reach_joints and (asked.any if reaches is None else reaches):
            pinned = reach_joints(poses, asked, options.reach, goes_on)
    if options.clean_feet:
        clean_feet(poses, options.feet, pinned, height_held)
    return layout.normalize(poses.features(heading)[:, 1:])


def _join(before: Poses, poses: Poses, asked: JointGoals | None, options: JoinOptions, patch: int) -> None:
    """Smooth poses (B, G) in place: from the poses before them, and from the frames of each token to the next."""
    skeleton, root = poses.layout.skeleton, poses.root
    held = root.new_zeros(root.shape[:2], dtype=torch.bool) if asked is None else asked.root_met(root)
    rotations = hinge_knees(skeleton, poses.rotations)
    rotations = settle_seam(skeleton, before.rotations, rotations, options)
    poses.rotations = join_rotations(before.rotations, rotations, options, patch)
    poses.root = join_roots(before.root, root, options, held, patch)
