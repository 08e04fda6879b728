"""Motion <-> feature vectors, in named blocks; also headings, the local root and recentring.

One frame has D = 12 J + 6 numbers: the root (world position 3, heading cos and sin 2), then the body (joint positions
3(J-1) with the root's x and z subtracted, global rotations 6J in 6-D form, joint velocities 3J in m/s, contacts 4).
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from motiongen_ardy.core.constants import constant, index
from motiongen_ardy.core.motion import Motion
from motiongen_ardy.core.rotation import angle_of, matrix_from_6d, matrix_to_6d
from motiongen_ardy.core.skeleton import Skeleton, forward_kinematics, global_to_local
from motiongen_ardy.core.stats import Stats

ROOT_WIDTH = 5
LOCAL_ROOT_WIDTH = 4
CONTACT_WIDTH = 4
CONTACT_SPEED_M_S = 0.15
CONTACT_HEIGHT_M = 0.10
ON_GROUND = (1.0, 0.0, 1.0)  # multiplies a position to set its height to 0


def heading_angle(skeleton: Skeleton, positions: Tensor) -> Tensor:
    """Heading (...) in radians about +Y, 0 toward +Z, from joint positions (..., J, 3): perpendicular to the hips."""
    right, left = skeleton.hip_joints
    return facing_of(positions[..., right, :] - positions[..., left, :])


def facing_of(hip_lines: Tensor) -> Tensor:
    """Heading (...) in radians, as `heading_angle`, from vectors (..., 3) from the left hip to the right one."""
    return angle_of(hip_lines[..., 2], -hip_lines[..., 0])


def repeat_last_valid(values: Tensor, lengths: Tensor) -> Tensor:
    """Overwrite frame n-1 with frame max(n-2, 0) in (B, T, ...), where n is each row's length."""
    last = (lengths - 1).clamp(min=0)
    before = (lengths - 2).clamp(min=0)
    rows = torch.arange(values.shape[0], device=values.device)
    is_last = (torch.arange(values.shape[1], device=values.device) == last[:, None])[..., None]
    flat = values.flatten(2)
    return torch.where(is_last, flat[rows, before][:, None], flat).view_as(values)


def velocities(positions: Tensor, lengths: Tensor, fps: int) -> Tensor:
    """Forward differences (B, T, ..., 3) in m/s; each row's last valid frame repeats the one before it."""
    difference = fps * (positions[:, 1:] - positions[:, :-1])
    return repeat_last_valid(torch.cat([difference, torch.zeros_like(positions[:, :1])], dim=1), lengths)


def contact_labels(skeleton: Skeleton, positions: Tensor, velocity: Tensor) -> Tensor:
    """(..., 4) bool: contact joints that are slow and low. positions: metres, velocity: m/s, both (..., J, 3)."""
    contact_joints = index(tuple(skeleton.contact_joints), positions.device)
    slow = velocity.index_select(-2, contact_joints).norm(dim=-1) < CONTACT_SPEED_M_S
    low = positions.index_select(-2, contact_joints)[..., 1] < CONTACT_HEIGHT_M
    return slow & low


def motion_from_pose(skeleton: Skeleton, local_rotations: Tensor, root_positions: Tensor, fps: int) -> Motion:
    """A motion (T) from poses; its foot contacts are computed as for the features.

    local_rotations: (T, J, 3, 3) parent-relative; root_positions: (T, 3) metres.
    """
    positions = forward_kinematics(skeleton, local_rotations, root_positions)[1][None]
    lengths = torch.tensor([positions.shape[1]], device=positions.device)
    contacts = contact_labels(skeleton, positions, velocities(positions, lengths, fps))[0]
    return Motion(local_rotations, root_positions, contacts, fps)


def wrapped_difference(heading_cos_sin: Tensor) -> Tensor:
    """Angle (B, T-1) in radians from each heading to the next, in (-pi, pi]; the (B, T, 2) given need not be unit."""
    angle = angle_of(heading_cos_sin[..., 1], heading_cos_sin[..., 0])
    cosine, sine = torch.cos(angle), torch.sin(angle)
    after = sine[:, 1:] * cosine[:, :-1] - cosine[:, 1:] * sine[:, :-1]
    along = cosine[:, 1:] * cosine[:, :-1] + sine[:, 1:] * sine[:, :-1]
    return angle_of(after, along)


class Representation(nn.Module):
    """The feature layout for a skeleton and frame rate, with its statistics.

    stats: of width D + 4, ordered root 5, local root 4, body D - 5 (the order of `stats/motion` in a checkpoint).
    """

    def __init__(self, skeleton: Skeleton, fps: int, stats: Stats) -> None:
        super().__init__()
        self.skeleton = skeleton
        self.fps = fps
        self.feature_dim = skeleton.feature_dim
        self.body_dim = self.feature_dim - ROOT_WIDTH
        local_end = ROOT_WIDTH + LOCAL_ROOT_WIDTH
        self.stats = stats
        self.root_stats = stats.select((0, ROOT_WIDTH))
        self.local_root_stats = stats.select((ROOT_WIDTH, local_end))
        self.feature_stats = stats.select((0, ROOT_WIDTH), (local_end, stats.width))
        joints = skeleton.num_joints
        start = 0
        blocks = []
        for width in (3, 2, 3 * (joints - 1), 6 * joints, 3 * joints, CONTACT_WIDTH):
            blocks.append(slice(start, start + width))
            start += width
        self.root_position_block, self.heading_block, self.position_block = blocks[:3]
        self.rotation_block, self.velocity_block, self.contact_block = blocks[3:]

    def normalize(self, features: Tensor) -> Tensor:
        """(..., D) natural units -> normalised."""
        return self.feature_stats.normalize(features)

    def denormalize(self, features: Tensor) -> Tensor:
        """(..., D) normalised -> natural units."""
        return self.feature_stats.denormalize(features)

    def features(self, local_rotations: Tensor, root_positions: Tensor, lengths: Tensor | None = None) -> Tensor:
        """Features (B, T, D) in natural units.

        local_rotations: (B, T, J, 3, 3); root_positions: (B, T, 3) metres; lengths: (B) valid frames; None: all.
        """
        rotations, positions = forward_kinematics(self.skeleton, local_rotations, root_positions)
        return self.features_from_global(rotations, positions, lengths)

    def features_from_global(self, rotations: Tensor, positions: Tensor, lengths: Tensor | None = None) -> Tensor:
        """As `features`, from global rotations (B, T, J, 3, 3) and world positions (B, T, J, 3)."""
        batch, num_frames = positions.shape[:2]
        if lengths is None:
            lengths = torch.full((batch,), num_frames, device=positions.device)
        root = positions[..., 0, :]
        heading = heading_angle(self.skeleton, positions)
        ground = torch.stack([root[..., 0], torch.zeros_like(root[..., 1]), root[..., 2]], dim=-1)
        velocity = velocities(positions, lengths, self.fps)
        return torch.cat(
            [
                root,
                torch.cos(heading)[..., None],
                torch.sin(heading)[..., None],
                (positions[..., 1:, :] - ground[..., None, :]).flatten(-2),
                matrix_to_6d(rotations).flatten(-2),
                velocity.flatten(-2),
                contact_labels(self.skeleton, positions, velocity).to(positions.dtype),
            ],
            dim=-1,
        )

    def global_rotations(self, features: Tensor) -> Tensor:
        """Global rotations (..., J, 3, 3) of features (..., D) in natural units; orthonormal whatever the input."""
        return matrix_from_6d(features[..., self.rotation_block].unflatten(-1, (self.skeleton.num_joints, 6)))

    def positions_block(self, features: Tensor) -> Tensor:
        """World positions (..., J, 3) from the position block of natural features (..., D); the root is at y = 0."""
        ground = features[..., None, self.root_position_block] * constant(ON_GROUND, features.dtype, features.device)
        others = features[..., self.position_block].unflatten(-1, (self.skeleton.num_joints - 1, 3)) + ground
        return torch.cat([ground, others], dim=-2)

    def motion(self, features: Tensor) -> Motion:
        """The motion of features (..., T, D) in natural units, from rotations and root; contact is value > 0.5."""
        local = global_to_local(self.skeleton, self.global_rotations(features))
        return Motion(local, features[..., self.root_position_block], features[..., self.contact_block] > 0.5, self.fps)

    def positions(self, features: Tensor, source: Literal["rotations", "positions"] = "rotations") -> Tensor:
        """World joint positions (..., J, 3) of features (..., D) in natural units.

        source: compute them from the rotations by forward kinematics, or read the position block.
        """
        if source == "positions":
            return self.positions_block(features)
        return self.motion(features).positions(self.skeleton)

    def rotate(self, features: Tensor, angle: Tensor, orthonormal: bool = False) -> Tensor:
        """Rotate features (B, T, D) in natural units by (B) radians about +Y through the world origin.

        The resulting rotations are orthonormal. orthonormal: True if the given ones already are, which is much cheaper.
        """
        cosine, sine = torch.cos(angle)[:, None], torch.sin(angle)[:, None]

        def turned(vectors: Tensor) -> Tensor:  # (B, T, 3k) -> (B, T, 3k)
            x, y, z = vectors[..., 0::3], vectors[..., 1::3], vectors[..., 2::3]
            across, along = cosine[..., None], sine[..., None]
            return torch.stack([across * x + along * z, y, across * z - along * x], dim=-1).flatten(-2)

        heading = features[..., self.heading_block]
        rotations = features[..., self.rotation_block]
        if not orthonormal:
            rotations = matrix_to_6d(self.global_rotations(features)).flatten(-2)
        return torch.cat(
            [
                turned(features[..., self.root_position_block]),
                (heading[..., 0] * cosine - heading[..., 1] * sine)[..., None],
                (heading[..., 0] * sine + heading[..., 1] * cosine)[..., None],
                turned(features[..., self.position_block]),
                turned(rotations),
                turned(features[..., self.velocity_block]),
                features[..., self.contact_block],
            ],
            dim=-1,
        )

    def translate_ground(self, features: Tensor, offset: Tensor) -> Tensor:
        """Move features (B, T, D) in natural units over the ground by (B, 2), x and z in metres."""
        moved = features.clone()
        moved[..., 0] += offset[:, None, 0]
        moved[..., 2] += offset[:, None, 1]
        return moved

    def canonicalize(self, features: Tensor) -> Tensor:
        """Rotate and move features (B, T, D) in natural units so that frame 0 faces +Z at x = z = 0."""
        heading = features[:, 0, self.heading_block]
        turned = self.rotate(features, -angle_of(heading[:, 1], heading[:, 0]))
        return self.translate_ground(turned, -turned[:, 0, [0, 2]])

    def heading_of_root(self, root: Tensor) -> Tensor:
        """Heading (...) in radians of a normalised root (..., 5)."""
        heading = self.root_stats.denormalize(root)[..., self.heading_block]
        return angle_of(heading[..., 1], heading[..., 0])

    def local_root(self, root: Tensor, lengths: Tensor) -> Tensor:
        """Normalised local root (B, T, 4) of a normalised root (B, T, 5) with valid lengths (B).

        The local root is heading rate (rad/s), world x and z velocity (m/s) and height (m).
        """
        natural = self.root_stats.denormalize(root)
        turn = self.fps * wrapped_difference(natural[..., self.heading_block])
        turn = repeat_last_valid(torch.cat([turn, turn.new_zeros(turn.shape[0], 1)], dim=1)[..., None], lengths)
        velocity = velocities(natural[..., self.root_position_block], lengths, self.fps)
        local = torch.cat([turn, velocity[..., 0::2], natural[..., 1:2]], dim=-1)
        return self.local_root_stats.normalize(local)

    def recentre(self, root: Tensor, frame: Tensor | int) -> tuple[Tensor, Tensor]:
        """Move a normalised root (B, T, 5) so that x = z = 0 at `frame`, which is (B) or one number for all rows.

        Returns the moved root and the centre (B, 3) = (x, 0, z) in metres that was subtracted.
        """
        rows = torch.arange(root.shape[0], device=root.device)
        natural = self.root_stats.denormalize(root[rows, frame])
        centre = natural[:, self.root_position_block] * constant(ON_GROUND, natural.dtype, natural.device)
        return self.translate_root(root, -centre), centre

    def translate_root(self, root: Tensor, offset: Tensor) -> Tensor:
        """Move a normalised root (B, T, 5) by (B, 3) metres; the y of the offset must be 0."""
        natural = self.root_stats.denormalize(root)
        moved = torch.cat([natural[..., :3] + offset[:, None], natural[..., 3:]], dim=-1)
        return self.root_stats.normalize(moved)
