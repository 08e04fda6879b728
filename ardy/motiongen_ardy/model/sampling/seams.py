"""Seams: a limb that a new window begins far from where the last one left it goes there on a smooth way.

After a new prompt the model may begin with arms raised that hung down one frame before. Such turns are too wide for the
joins of tokens, which are linear; here the first frame's turn away from the history is taken back and given out over
the following frames (inertialisation, Bollo 2018), wider turns over more of them.
"""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import axis_angle_to_matrix, matrix_to_6d, rotation_vector
from motiongen_ardy.core.skeleton import forward_kinematics, global_to_local
from motiongen_ardy.model.sampling.options import JoinOptions
from motiongen_ardy.model.sampling.spread import smooth_step


def settle_seam(layout: Representation, history: Tensor, new: Tensor, options: JoinOptions) -> Tensor:
    """New frames (B, G, D), in natural units, with rotations that go on from the history's; the rest stays as it was.

    history: (B, H, D), of which the last two frames count; with none, nothing is known to go on from. Joints whose
    first local rotation is within `options.free_rad` of where the history leads are left alone, bit for bit.
    """
    if not history.shape[1]:
        return new
    skeleton = layout.skeleton
    before = global_to_local(skeleton, layout.global_rotations(history[:, -2:]))
    after = global_to_local(skeleton, layout.global_rotations(new))
    last = before[:, -1]
    going_on = rotation_vector(last @ before[:, 0].transpose(-1, -2))  # of one frame; zero where only one is known
    expected = axis_angle_to_matrix(going_on) @ last
    apart = rotation_vector(expected @ after[:, 0].transpose(-1, -2))  # (B, J, 3)
    apart = torch.cat([torch.zeros_like(apart[:, :1]), apart[:, 1:]], dim=1)  # the root's is the plan's
    angle = apart.norm(dim=-1, keepdim=True)
    kept = apart * ((angle - options.free_rad).clamp(min=0) / angle.clamp(min=1e-6))
    touched = kept.abs().sum(-1) > 0  # (B, J)
    if not bool(touched.any()):
        return new
    frames = torch.arange(new.shape[1], device=new.device)[None, :, None]
    span = options.settle_frames * (1 + (angle[..., 0] / torch.pi).clamp(max=1))[:, None]  # (B, 1, J)
    share = 1 - smooth_step(frames / span)  # (B, G, J): whole at the first frame
    turned = axis_angle_to_matrix(kept[:, None] * share[..., None]) @ after
    rows = touched.any(-1)
    local = torch.where(touched[:, None, :, None, None], turned, after)
    rotations, _ = forward_kinematics(skeleton, local, new[..., layout.root_position_block])
    settled = new.clone()
    settled[..., layout.rotation_block] = matrix_to_6d(rotations).flatten(-2)
    return torch.where(rows[:, None, None], settled, new)
