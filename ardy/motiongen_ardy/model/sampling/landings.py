"""Landings: a foot whose next place is far away gets enough frames to move there.

The model may declare a foot standing while it still glides to its next place, from one frame to the next: right behind
a seam, or in a step that it cut short. Held in place from the first of these frames on, the foot would jump there;
instead it moves through the air and stands later.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.model.sampling.spread import PEAK_ACCELERATION, gaps

ACCELERATION_M_S2 = 40.0
"""The most acceleration that hurrying to its place adds to a foot's own: half of what occurs in runs."""
SOLE_M = 0.16  # distance that a toe moves per radian of its foot's turn
FULL_LIFT_M = 0.3  # from this distance on, a foot is lifted as high as in any inserted step


def late_landings(
    offsets: Tensor, known: Tensor, number: Tensor, pinned: Tensor, fps: int
) -> tuple[Tensor, Tensor] | None:
    """Frames (B, T, 2) in which a foot is still on its way to where it will stand, and how far (B, T, 2) it is lifted.

    offsets: (B, T, 2, 4), metres x, y, z and radians, which move each foot to its place where known (B, T, 2); number:
    (B, T, 2), runs of `stance.segments`; pinned: (B, T, 2), frames at which a foot must be in place: no way is
    lengthened across one. Frame 0 does not change. Lifts are shares of the lift of a step. Returns None if all feet
    have the time they need.
    """
    num_frames = known.shape[1]
    frames = torch.arange(num_frames, device=known.device)
    _, after = gaps(known)
    right = torch.cat([after[:, 1:], torch.full_like(after[:, :1], num_frames)], dim=1)
    is_last = known & (right < num_frames)  # the last frame of its stance, with another stance following
    right = right.clamp(max=num_frames - 1)
    is_last &= number != number.gather(1, right)
    off = offsets.gather(1, right[..., None].expand_as(offsets)) - offsets
    far = torch.cat([off[..., :3], SOLE_M * off[..., 3:]], dim=-1).norm(dim=-1)
    needed = (fps * (PEAK_ACCELERATION * far / ACCELERATION_M_S2).sqrt()).round().long()
    missing = torch.where(is_last, needed - (right - frames[:, None]), 0).clamp(min=0)
    if _all_in_time(missing):
        return None
    begin = (frames[:, None] - missing // 2).clamp(min=0)
    end = begin + (right - frames[:, None]) + missing
    pins = pinned.cumsum(dim=1)
    passed = pins.gather(1, end.clamp(max=num_frames - 1)) - pins.gather(1, begin) + pinned.gather(1, begin)
    is_way = (missing > 0) & (passed == 0)
    # For each frame (dimension 2) in each way from one place to the next (dimension 3).
    share = (frames[:, None, None] - begin[:, None]).to(far.dtype) / (end - begin).clamp(min=1)[:, None]
    is_on_way = is_way[:, None] & (share > 0) & (share < 1)
    lifted = 16 * (share * (1 - share)).square() * (far / FULL_LIFT_M).clamp(max=1)[:, None]
    return is_on_way.any(dim=2), torch.where(is_on_way, lifted, 0.0).amax(dim=2)


def _all_in_time(missing: Tensor) -> bool:
    """Whether no frames are missing; on a GPU always False, since finding out would synchronise."""
    return missing.device.type != "cuda" and not bool(missing.any())
