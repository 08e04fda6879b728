"""Converts features to wire rows, and wire rows to features."""

from __future__ import annotations

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation
from motiongen_ardy.core.rotation import quaternion_to_matrix
from motiongen_ardy.core.skeleton import local_quaternions


def wire_rows(layout: Representation, features: Tensor) -> Tensor:
    """Rows (B, G, row width) for normalised features (B, G, D): root, parent-relative quaternions, contacts."""
    natural = layout.denormalize(features)
    quaternions = local_quaternions(layout.skeleton, layout.global_rotations(natural))  # (4, B, G, J)
    # Neighbouring frames use the same sign of q and -q, so that a client may interpolate the numbers.
    dots = (quaternions[:, :, 1:] * quaternions[:, :, :-1]).sum(0)
    first = torch.where(quaternions[0, :, :1] < 0, -1.0, 1.0)
    signs = torch.cat([first, torch.where(dots < 0, -1.0, 1.0)], dim=1).cumprod(dim=1)
    root, contacts = natural[..., layout.root_position_block], natural[..., layout.contact_block] > 0.5
    return torch.cat([root, (quaternions * signs).movedim(0, -1).flatten(-2), contacts.float()], dim=-1)


def features_of_rows(layout: Representation, rows: Tensor) -> Tensor:
    """Normalised features (B, G, D) for rows (B, G, row width). Contacts are detected again, as in training data."""
    num_joints = layout.skeleton.num_joints
    quaternions = rows[..., 3 : 3 + 4 * num_joints].reshape(*rows.shape[:-1], num_joints, 4)
    return layout.normalize(layout.features(quaternion_to_matrix(quaternions), rows[..., :3]))
