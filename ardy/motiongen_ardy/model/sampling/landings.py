"""Landings: a foot whose next place is far off has the frames that it takes to go there.

The model may say that a foot stands while it still glides to where it is to stand, and that between two frames: right
behind a seam, or within a step that it cut short. Held in its place from the first of these frames on, the foot would
be there at once; it goes there through the air instead, and stands later.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.model.sampling.spread import PEAK_ACCELERATION, gaps

ACCELERATION_M_S2 = 40.0
"""The most by which a foot is hurried to its place beside what the model has it do: half of what runs have."""
SOLE_M = 0.16  # what a toe goes for each radian that its foot turns
FULL_LIFT_M = 0.3  # so far off, and farther, a foot is lifted as high as in any step that is put in


def late_landings(
    offsets: Tensor, known: Tensor, number: Tensor, pinned: Tensor, fps: int
) -> tuple[Tensor, Tensor] | None:
    """Frames (B, T, 2) in which a foot is still on its way to where it is to stand, and how far (B, T, 2) it is lifted.

    offsets: (B, T, 2, 4) metres x, y, z and radians, which move each foot to its place where known (B, T, 2);
    number: (B, T, 2), runs of `stance.segments`; pinned: (B, T, 2), frames at which the feet are in place whatever
    comes: no way that would go over one is made longer. Frame 0 stays. Lifts are shares of that of a step. None where
    all feet have the time they need.
    """
    num_frames = known.shape[1]
    frames = torch.arange(num_frames, device=known.device)
    _, after = gaps(known)
    right = torch.cat([after[:, 1:], torch.full_like(after[:, :1], num_frames)], dim=1)
    is_last = known & (right < num_frames)  # of its stance, another one following
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
    # Of each frame (second) in each way from one place to the next (third).
    share = (frames[:, None, None] - begin[:, None]).to(far.dtype) / (end - begin).clamp(min=1)[:, None]
    is_on_way = is_way[:, None] & (share > 0) & (share < 1)
    lifted = 16 * (share * (1 - share)).square() * (far / FULL_LIFT_M).clamp(max=1)[:, None]
    return is_on_way.any(dim=2), torch.where(is_on_way, lifted, 0.0).amax(dim=2)


def _all_in_time(missing: Tensor) -> bool:
    """Whether frames are missing nowhere; on a GPU False, since to ask would be to wait."""
    return missing.device.type != "cuda" and not bool(missing.any())
