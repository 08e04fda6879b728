"""Stance: when a foot stands on heel, toe or both, and how far it slips meanwhile."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motiongen_ardy.core.constants import constant
from motiongen_ardy.model.sampling.options import FeetOptions
from motiongen_ardy.model.sampling.spread import gaps

CONTACT_ENTER = 0.45
CONTACT_STAY = 0.35
PACE_FRAMES = 2


def hysteresis(enter: Tensor, stay: Tensor) -> Tensor:
    """State (B, T, C) that turns on at a frame of `enter` and stays on as long as `stay` holds."""
    entered, _ = gaps(enter & stay)
    left, _ = gaps(~stay)
    return (entered > left) & stay


def contact_states(contacts: Tensor, positions: Tensor, pace: Tensor, fps: int, options: FeetOptions) -> Tensor:
    """Whether (B, T, 4) heel and toe of each foot carry weight.

    contacts: (B, T, 4), from the model, about 0 to 1; positions: (B, T, 4, 3), metres; pace: (B, T), of the root,
    metres a second. A joint that is low and slow (also relative to the root's pace) is in contact whatever the model
    says; one that is fast or high is not. A single frame between two frames of contact counts as contact.
    """
    step = (positions[:, 1:] - positions[:, :-1]).norm(dim=-1) * fps
    speed = torch.minimum(torch.cat([step, step[:, -1:]], dim=1), torch.cat([step[:, :1], step], dim=1))
    height = positions[..., 1] - constant((options.heel_m, options.toe_m) * 2, positions.dtype, positions.device)
    slow = (options.slow_share * pace).clamp(min=options.slow_m_s)[..., None]
    sure = (contacts > CONTACT_ENTER) | ((speed < slow) & (height < options.low_m))
    possible = (speed < options.fast_m_s) & (height < options.high_m)
    state = hysteresis(sure & possible, possible & ((contacts > CONTACT_STAY) | (speed < slow)))
    state[:, 1:-1] |= state[:, :-2] & state[:, 2:]
    return state


def pace_of(root: Tensor, fps: int) -> Tensor:
    """Speed (B, T) over the ground, metres a second, of a root (B, T, 3), averaged over about a quarter of a second."""
    step = (root[:, 1:] - root[:, :-1])[..., 0::2].norm(dim=-1) * fps
    step = torch.cat([step[:, :1], step], dim=1)
    padded = functional.pad(step[:, None], (PACE_FRAMES, PACE_FRAMES), mode="replicate")
    return functional.avg_pool1d(padded, 2 * PACE_FRAMES + 1, stride=1)[:, 0]


def slip(states: Tensor, positions: Tensor) -> Tensor:
    """How far (B, T, 2, 3) in metres each foot has slipped since the first frame while it stood.

    states: (B, T, 4), from `contact_states`; positions: (B, T, 4, 3). Measured at the joint that is in contact at both
    of two neighbouring frames, or as the mean if heel and toe both are; if weight passes from one to the other between
    two frames, at the slower one.
    """
    states, positions = states.unflatten(2, (2, 2)), positions.unflatten(2, (2, 2))
    step = positions[:, 1:] - positions[:, :-1]  # (B, T - 1, 2, 2, 3)
    both = (states[:, 1:] & states[:, :-1]).to(step.dtype)
    count = both.sum(dim=-1, keepdim=True)
    mean = (step * both[..., None]).sum(dim=-2) / count.clamp(min=1)
    slower = torch.where((step[..., 0, :].norm(dim=-1) < step[..., 1, :].norm(dim=-1))[..., None], *step.unbind(-2))
    standing = states.any(dim=-1)
    moved = torch.where(count > 0, mean, slower) * (standing[:, 1:] & standing[:, :-1])[..., None]
    return torch.cat([torch.zeros_like(positions[:, :1, :, 0]), moved.cumsum(dim=1)], dim=1)


def segments(states: Tensor) -> Tensor:
    """For states (B, T, C): the number (B, T, C) of the run that each frame belongs to, ascending from 0."""
    starts = torch.cat([torch.zeros_like(states[:, :1]), states[:, 1:] != states[:, :-1]], dim=1)
    return starts.cumsum(dim=1)


def run_sums(values: Tensor, number: Tensor) -> Tensor:
    """Values (B, T, C, k) summed over each run of `segments` (B, T, C), repeated at each of its frames."""
    index = number[..., None].expand(values.shape)
    return torch.zeros_like(values).scatter_add(1, index, values).gather(1, index)
