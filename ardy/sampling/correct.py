"""One entry for what is corrected on a finished window before its frames are committed."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ardy.constraint import Targets
from ardy.representation import Representation
from ardy.sampling.cleanup import clean_feet
from ardy.sampling.options import SamplingOptions
from ardy.sampling.pose import Poses


def correct_window(
    layout: Representation,
    history: Tensor,
    new: Tensor,
    targets: Sequence[Targets | None],
    first_frames: Sequence[int],
    options: SamplingOptions,
) -> Tensor:
    """The new frames (B, G, D) of B rows with their feet in place and their joints on their goals, as options say.

    history: (B, H, D), of which the last frame counts, H 0 where a motion begins; new: (B, G, D); both normalised, in
    the world frame. targets: each row's by absolute frame; first_frames: the frame that each row's first new one is.
    Without clean_feet and reach_joints the new frames come back as they are. Raises ConfigError for a skeleton whose
    legs have more than two bones.
    """
    if not options.corrects or not new.shape[1]:
        return new
    before = history[:, -1:] if history.shape[1] else new[:, :1]
    natural = layout.denormalize(torch.cat([before, new], dim=1))
    poses = Poses(layout, natural)
    pinned = torch.zeros(*natural.shape[:2], 2, dtype=torch.bool, device=new.device)
    height_held = torch.zeros(natural.shape[:2], dtype=torch.bool, device=new.device)
    if options.clean_feet:
        clean_feet(poses, options.feet, pinned, height_held)
    return layout.normalize(poses.features(natural))[:, 1:]
