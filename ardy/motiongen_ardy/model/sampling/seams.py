"""Seams: a limb that starts a new window far from where the last one left it moves there smoothly.

After a new prompt, the model may begin with arms raised that hung down one frame before. Such turns are too wide for
the joins of tokens, which are linear; here the first frame's turn away from the history is undone and then released
over the following frames (inertialisation, Bollo 2018), over more frames for wider turns. The same is done with the
speed at which arms and trunk start to move. Legs start as the window says: in a walk, feet gain their speed at once.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.constants import index
from motiongen_ardy.core.rotation import axis_angle_to_matrix, rotation_vector
from motiongen_ardy.core.skeleton import Skeleton, global_to_local
from motiongen_ardy.model.sampling.options import JoinOptions
from motiongen_ardy.model.sampling.spread import smooth_step


def settle_seam(skeleton: Skeleton, history: Tensor, new: Tensor, options: JoinOptions) -> Tensor:
    """The new frames' global rotations (B, G, J, 3, 3), made to continue from the history's.

    history: (B, H, J, 3, 3), of which only the last two frames are used; without history, `new` is returned. Joints
    whose first local rotation is within `options.free_rad` of where the history leads, and whose first turn is within
    `options.free_start_rad` of the history's last, stay bit for bit the same.
    """
    if not history.shape[1]:
        return new
    before, after = global_to_local(skeleton, history[:, -2:]), global_to_local(skeleton, new[:, :2])
    last = before[:, -1]
    # How much faster than in the history a joint starts, per frame; needs two frames on each side.
    known = before.shape[1] > 1 and after.shape[1] > 1
    later, earlier = (torch.stack([last, after[:, -1]]), torch.stack([before[:, 0], after[:, 0]]))
    going_on, setting_off = rotation_vector(later @ earlier.transpose(-1, -2))  # per frame; zero if there is only one
    expected = axis_angle_to_matrix(going_on) @ last
    apart = rotation_vector(expected @ after[:, 0].transpose(-1, -2))  # (B, J, 3)
    apart = torch.cat([torch.zeros_like(apart[:, :1]), apart[:, 1:]], dim=1)  # the root is left to the plan
    jump = _beyond(apart, options.free_rad)
    start = _beyond(going_on - setting_off if known else torch.zeros_like(going_on), options.free_start_rad)
    start = start.index_fill(1, _legs_and_root(skeleton, start.device), 0.0)
    touched = (jump != 0).any(-1) | (start != 0).any(-1)  # (B, J)
    joints = _joints_of(touched)
    if not joints:
        return new
    chosen = index(tuple(joints), new.device)
    jump, start = jump[:, chosen], start[:, chosen]
    longest = min(2 * options.settle_frames, new.shape[1])  # beyond, nothing is left to settle
    frames = torch.arange(longest, device=new.device)[None, :, None]
    span = options.settle_frames * (1 + (jump.norm(dim=-1) / torch.pi).clamp(max=1))[:, None]  # (B, 1, n)
    share, slope = _settling(frames / span)
    curve = jump[:, None] * share[..., None] + start[:, None] * (span * slope)[..., None]
    return torch.cat([_turned(skeleton, new[:, :longest], curve, joints, touched), new[:, longest:]], dim=1)


def _turned(skeleton: Skeleton, whole: Tensor, curve: Tensor, joints: list[int], touched: Tensor) -> Tensor:
    """Global rotations (B, G, J, 3, 3) with joints (n) turned by rotation vectors (B, G, n, 3) in parent frames.

    touched: (B, J), joints that each row turns. Their descendants turn with them; all else stays bit for bit the same.
    """
    parents = skeleton.parents
    above = whole[:, :, index(tuple(parents[joint] for joint in joints), whole.device)]
    turns = axis_angle_to_matrix((above @ curve[..., None]).squeeze(-1))  # in the world: needs no local rotations
    by_joint: dict[int, Tensor] = {}
    follows = touched.clone()
    for joint in range(1, skeleton.num_joints):
        carried = by_joint.get(parents[joint])
        follows[:, joint] |= follows[:, parents[joint]]
        if joint in joints:
            own = turns[:, :, joints.index(joint)]
            by_joint[joint] = own if carried is None else carried @ own
        elif carried is not None:
            by_joint[joint] = carried
    moved = index(tuple(by_joint), whole.device)
    before = whole[:, :, moved]
    after = torch.stack(list(by_joint.values()), dim=2) @ before
    settled = whole.clone()
    settled[:, :, moved] = torch.where(follows[:, None, moved, None, None], after, before)
    return settled


def _joints_of(touched: Tensor) -> list[int]:
    """Joints that any row (B, J) turns; on a GPU all but the root, since finding out would synchronise."""
    if touched.device.type != "cuda":
        return touched.any(dim=0).nonzero().flatten().tolist()
    return list(range(1, touched.shape[1]))


def _legs_and_root(skeleton: Skeleton, device: torch.device) -> Tensor:
    """The joints that start as the window says: feet swing fast from one frame to the next."""
    joints = [0]
    for chain in (skeleton.left_foot, skeleton.right_foot):
        knee = skeleton.parents[chain[0]]
        joints += [skeleton.parents[knee], knee, *chain]
    return index(tuple(joints), device)


def _beyond(turns: Tensor, free: float) -> Tensor:
    """The part of rotation vectors (..., 3) that exceeds `free` radians."""
    length = turns.norm(dim=-1, keepdim=True)
    return turns * ((length - free).clamp(min=0) / length.clamp(min=1e-6))


def _settling(share: Tensor) -> tuple[Tensor, Tensor]:
    """Curves over the share of a span, at rest at its end: one from 1 with slope 0, one from 0 with slope 1."""
    x = share.clamp(0, 1)
    return 1 - smooth_step(x), x * (1 - x) ** 3 * (1 + 3 * x)
