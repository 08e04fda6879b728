"""Where feet are held: the offsets over the ground that keep a standing foot in place, per window."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.constants import constant
from motiongen_ardy.model.sampling.landings import late_landings
from motiongen_ardy.model.sampling.options import FeetOptions
from motiongen_ardy.model.sampling.spread import held, spread, within
from motiongen_ardy.model.sampling.stance import run_sums, segments

# Around the middle of an inserted step: frames in which its foot moves over the ground, and in which it is in the air.
STEP_FRAMES, AIR_FRAMES = 2, 4
TORN_FRAMES = 6
TORN_M, TORN_RAD = 0.005, 0.03  # how far from its goal a foot may be held
SLOW_M = 0.01  # per frame; frames in which the foot slips less than this weigh more in the place of a stance
ON_THE_SPOT_M_S = 0.3
LEFT_RIGHT_PHASE = (0.25, 0.75)  # so that both feet of a gliding body do not step at once


def breaks(standing: Tensor, slipped: Tensor, twisted: Tensor, pace: Tensor, options: FeetOptions) -> Tensor:
    """Frames (B, T, 2) at which a foot that slips or turns too far in one stance is to take a step.

    standing: (B, T, 2) bool; slipped: (B, T, 2, 3), metres, from `stance.slip`; twisted: (B, T, 2), from `twist.twist`;
    pace: (B, T), of the root, metres a second: a walking character lifts its feet anyway, and turns them then.
    """
    number = segments(standing)
    first = torch.cat([torch.ones_like(standing[:, :1]), number[:, 1:] != number[:, :-1]], dim=1)
    moved = torch.cat([slipped[..., 0::2] / options.stride_m, twisted[..., None] / options.twist_rad], dim=-1)
    moved = moved - held(moved, first)
    slid = moved[..., :2].norm(dim=-1)
    far = torch.stack([slid, torch.maximum(slid, moved[..., 2].abs())], dim=-1)
    piece = (far + constant(LEFT_RIGHT_PHASE, far.dtype, far.device)[:, None]).floor()
    passed = torch.cat([torch.zeros_like(piece[:, :1], dtype=torch.bool), piece[:, 1:] > piece[:, :-1]], dim=1)
    passed = torch.where((pace < ON_THE_SPOT_M_S)[..., None], passed[..., 1], passed[..., 0])
    return passed & standing & ~first


def ground_offsets(
    standing: Tensor, slipped: Tensor, twisted: Tensor, pace: Tensor, pinned: Tensor, *, fps: int, options: FeetOptions
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Offsets (B, T, 2, 3) of the feet over the ground, each foot's turn and lift (B, T, 2), and when they stand.

    A stance is held at its mean position, weighted toward slow frames; the stance of frame 0 at the position of frame
    0; a stance with pinned frames (B, T, 2) at the position of those. Between two stances, and after frame 0, the
    offsets are interpolated.
    """
    broken = breaks(standing, slipped, twisted, pace, options) & ~within(pinned, TORN_FRAMES)
    standing = standing & ~within(broken, STEP_FRAMES)
    # A foot that the history holds elsewhere than a pinned frame must be released before it.
    elsewhere = (slipped.norm(dim=-1) > TORN_M) | (twisted.abs() > TORN_RAD)
    torn = pinned & standing & (segments(standing) == 0) & elsewhere
    standing = standing & ~within(torn, TORN_FRAMES)
    number = segments(standing)
    frames = torch.arange(standing.shape[1], device=standing.device)[None, :, None]
    pins = pinned & standing
    has_pins = run_sums(pins[..., None].to(slipped.dtype), number)[..., 0] > 0
    counted = torch.where(number == 0, frames == 0, torch.where(has_pins, pins, standing))
    step = torch.cat([slipped[:, 1:2] - slipped[:, :1], slipped[:, 1:] - slipped[:, :-1]], dim=1).norm(dim=-1)
    weight = ((counted & standing) / (1 + (step / SLOW_M).square()))[..., None]
    moved = torch.cat([slipped, twisted[..., None]], dim=-1)
    place = run_sums(weight * moved, number) / run_sums(weight, number).clamp(min=1e-6)
    known = standing | pinned | (frames == 0)
    kept = torch.where(standing[..., None], place - moved, 0.0) * constant(
        (1.0, 0.0, 1.0, 1.0), slipped.dtype, slipped.device
    )
    bump = spread((broken & ~pinned)[..., None].to(slipped.dtype), broken | pinned, AIR_FRAMES)[..., 0]
    late = late_landings(kept, known, number, pinned, fps)
    if late is not None:
        is_late, lifted = late
        standing, known = standing & ~is_late, known & ~is_late
        bump = torch.maximum(bump, lifted)
    kept = spread(kept, known, options.fade_frames)
    return kept[..., :3], kept[..., 3], options.lift_m * bump, standing
