"""Chooses which features of training windows the denoiser sees as constraints: all forms that a server accepts.

A constraint is a set of frames times a set of feature groups (ground position, height, heading, one joint's position,
one joint's rotation). Whole batches are drawn at once, with tensors of fixed shapes, on the device of the windows. The
columns that a form covers are those that `motiongen_ardy.core.constraint` fills for it at run time; the forms are the
paper's (section 3.4) and the further ones of the service: single joints, rotations alone, headings alone, root height
alone, and roots at every second to tenth frame, which is the form of planned paths and velocities.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import torch
from torch import Tensor

from motiongen_ardy.core.representation import Representation

STRIDES = (1, 1, 2, 4, 5, 8, 10)


@dataclass(frozen=True)
class ConstraintChances:
    """The chances that a window has no constraint, or a second form; and the share of each form among the others."""

    none: float = 0.12
    second_form: float = 0.45
    waypoints: float = 0.17
    trajectory: float = 0.33
    heading: float = 0.04
    height: float = 0.03
    keyframes: float = 0.14
    keyframe_block: float = 0.04
    end_effectors: float = 0.10
    planted_feet: float = 0.03
    joints: float = 0.06
    rotations: float = 0.06

    @property
    def shares(self) -> tuple[float, ...]:
        """The shares of the forms, in the order of `FORMS`."""
        return tuple(float(getattr(self, name)) for name in FORMS)


FORMS = tuple(field.name for field in fields(ConstraintChances) if field.name not in ("none", "second_form"))


@dataclass(frozen=True)
class WindowSpans:
    """Where windows (B) may be constrained: frames first .. end - 1, of which first .. horizon_end - 1 are generated.

    planted: (B, T, 2) bool, whether the left and right heel are in contact.
    """

    first: Tensor
    horizon_end: Tensor
    end: Tensor
    planted: Tensor


class ConstraintSampler:
    """Draws feature masks (B, T, D) for windows of one representation."""

    def __init__(self, representation: Representation, chances: ConstraintChances | None = None) -> None:
        self.chances = chances or ConstraintChances()
        skeleton = representation.skeleton
        joints = skeleton.num_joints
        self.num_joints = joints
        self.ground, self.height, self.heading = 0, 1, 2
        self.position = 3  # joint j's position is group position + j - 1, since the root's own is ground and height
        self.rotation = self.position + joints - 1
        self.num_groups = self.rotation + joints
        device = representation.stats.mean.device
        group = torch.full((representation.feature_dim,), self.num_groups, device=device)
        group[:5] = torch.tensor([0, 1, 0, 2, 2], device=device)
        for joint in range(1, joints):
            start = representation.position_block.start + 3 * (joint - 1)
            group[start : start + 3] = self.position + joint - 1
        for joint in range(joints):
            start = representation.rotation_block.start + 6 * joint
            group[start : start + 6] = self.rotation + joint
        self.group_of_column = group
        self.shares = torch.tensor(self.chances.shares, device=device)
        self.strides = torch.tensor(STRIDES, device=device)
        chains = (skeleton.left_hand, skeleton.right_hand, skeleton.left_foot, skeleton.right_foot)
        limbs = torch.zeros(4, self.num_groups, dtype=torch.bool, device=device)
        for limb, chain in enumerate(chains):
            limbs[limb, [self.position + joint - 1 for joint in chain]] = True
            limbs[limb, self.rotation + chain[0]] = True
        self.limbs = limbs
        self.pose_root = self._groups(self.ground, self.height, self.heading, device=device)
        self.whole_pose = self.pose_root.clone()
        self.whole_pose[self.position : self.rotation] = True
        self.ends = torch.tensor([chain[0] for chain in chains] + [skeleton_head(skeleton)], device=device)

    def _groups(self, *chosen: int, device: torch.device) -> Tensor:
        mask = torch.zeros(self.num_groups, dtype=torch.bool, device=device)
        mask[list(chosen)] = True
        return mask

    def sample(self, spans: WindowSpans, generator: torch.Generator | None = None) -> Tensor:
        """Masks (B, T, D) bool, true only within frames first .. end - 1 of each window."""
        batch, num_frames = spans.planted.shape[:2]
        groups = torch.zeros(batch, num_frames, self.num_groups, dtype=torch.bool, device=spans.first.device)
        chance = self._uniform(generator, batch)
        for order in range(2):
            frames, chosen = self._form(spans, generator)
            drawn = chance >= self.chances.none
            if order:
                drawn = drawn & (self._uniform(generator, batch) < self.chances.second_form)
            groups |= (frames & drawn[:, None])[..., None] & chosen[:, None]
        padded = torch.cat([groups, torch.zeros_like(groups[..., :1])], dim=-1)  # velocities and contacts: never
        return padded.index_select(-1, self.group_of_column)

    def _uniform(self, generator: torch.Generator | None, *shape: int) -> Tensor:
        return torch.rand(shape, generator=generator, device=self.group_of_column.device)

    def _form(self, spans: WindowSpans, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
        """One form for each window: its frames (B, T) and its groups (B, G)."""
        batch = len(spans.first)
        device = spans.first.device
        share = self._uniform(generator, batch)
        bounds = self.shares.cumsum(0) / self.shares.sum()
        form = torch.searchsorted(bounds, share, right=True).clamp(max=len(FORMS) - 1)
        # Half of the goals are within the horizon; the others anywhere, so that distant goals are seen too.
        near = self._uniform(generator, batch) < 0.5
        limit = torch.where(near, spans.horizon_end, spans.end)
        few = self._few_frames(spans, limit, 3, generator)
        run = self._run(spans, limit, generator)
        block = self._block(spans, limit, generator)
        planted_side = (self._uniform(generator, batch) < 0.5).long()
        on_foot = spans.planted.gather(-1, planted_side[:, None, None].expand(-1, spans.planted.shape[1], 1))[..., 0]
        ways = {
            "waypoints": (few, self._root_groups(generator, batch)),
            "trajectory": (run, self._root_groups(generator, batch)),
            "heading": (torch.where(near[:, None], few, run), self._only(self.heading, batch)),
            "height": (few, self._only(self.height, batch)),
            "keyframes": (few, self.whole_pose.expand(batch, -1)),
            "keyframe_block": (block, self.whole_pose.expand(batch, -1)),
            "end_effectors": (few, self._end_effectors(generator, batch)),
            "planted_feet": (few & on_foot, self.limbs[2 + planted_side] | self.pose_root),
            "joints": (few, self._joints(generator, batch)),
            "rotations": (few, self._rotations(generator, batch)),
        }
        frames = torch.stack([ways[name][0] for name in FORMS], dim=1)
        groups = torch.stack([ways[name][1] for name in FORMS], dim=1)
        rows = torch.arange(batch, device=device)
        return frames[rows, form], groups[rows, form]

    def _inside(self, spans: WindowSpans, limit: Tensor) -> Tensor:
        """(B, T) bool: frames first .. limit - 1."""
        frames = torch.arange(spans.planted.shape[1], device=limit.device)
        return (frames >= spans.first[:, None]) & (frames < limit[:, None])

    def _few_frames(self, spans: WindowSpans, limit: Tensor, most: int, generator: torch.Generator | None) -> Tensor:
        """1 to `most` frames per window; all counts are equally likely."""
        batch, num_frames = spans.planted.shape[:2]
        score = self._uniform(generator, batch, num_frames).masked_fill(~self._inside(spans, limit), -1.0)
        best = score.topk(most, dim=1).indices
        kept = torch.arange(most, device=limit.device) < (1 + self._uniform(generator, batch) * most).long()[:, None]
        frames = torch.zeros_like(score).scatter(1, best, kept.to(score.dtype))
        return (frames > 0) & (score >= 0)

    def _run(self, spans: WindowSpans, limit: Tensor, generator: torch.Generator | None) -> Tensor:
        """Every n-th frame of a stretch, which is the whole window in 60 % of cases."""
        batch, num_frames = spans.planted.shape[:2]
        room = (limit - spans.first).clamp(min=1)
        whole = self._uniform(generator, batch) < 0.6
        start = torch.where(whole, 0, (self._uniform(generator, batch) * room).long())
        length = torch.where(whole, room, 1 + (self._uniform(generator, batch) * (room - start)).long())
        stride = self.strides[(self._uniform(generator, batch) * len(self.strides)).long()]
        phase = (self._uniform(generator, batch) * stride).long()
        at = torch.arange(num_frames, device=limit.device) - (spans.first + start)[:, None]
        on = (at >= 0) & (at < length[:, None]) & ((at + phase[:, None]) % stride[:, None] == stride[:, None] - 1)
        return on & self._inside(spans, limit)

    def _block(self, spans: WindowSpans, limit: Tensor, generator: torch.Generator | None) -> Tensor:
        """4 to 16 consecutive frames."""
        batch, num_frames = spans.planted.shape[:2]
        room = (limit - spans.first).clamp(min=1)
        start = spans.first + (self._uniform(generator, batch) * room).long()
        length = 4 + (self._uniform(generator, batch) * 13).long()
        at = torch.arange(num_frames, device=limit.device) - start[:, None]
        return (at >= 0) & (at < length[:, None]) & self._inside(spans, limit)

    def _only(self, group: int, batch: int) -> Tensor:
        mask = torch.arange(self.num_groups, device=self.group_of_column.device) == group
        return mask.expand(batch, -1)

    def _root_groups(self, generator: torch.Generator | None, batch: int) -> Tensor:
        """The ground position, in 60 % of windows with the heading, in 10 % with the height."""
        groups = self._only(self.ground, batch)
        groups = groups | (self._only(self.heading, batch) & (self._uniform(generator, batch, 1) < 0.6))
        return groups | (self._only(self.height, batch) & (self._uniform(generator, batch, 1) < 0.1))

    def _end_effectors(self, generator: torch.Generator | None, batch: int) -> Tensor:
        """One to three limbs of a pose with its root, in half of the windows with the hips' rotation."""
        score = self._uniform(generator, batch, 4)
        count = 1 + (self._uniform(generator, batch, 1) * 3).long()
        chosen = score.argsort(dim=1).argsort(dim=1) < count
        groups = (chosen[..., None] & self.limbs).any(dim=1) | self.pose_root
        return groups | (self._only(self.rotation, batch) & (self._uniform(generator, batch, 1) < 0.5))

    def _some_joints(self, generator: torch.Generator | None, batch: int) -> Tensor:
        """(B, J) bool: in 60 % of windows a hand, a foot or the head alone, in the others one to three joints."""
        score = self._uniform(generator, batch, self.num_joints)
        count = 1 + (self._uniform(generator, batch, 1) * 3).long()
        some = score.argsort(dim=1).argsort(dim=1) < count
        end = self.ends[(self._uniform(generator, batch) * len(self.ends)).long()]
        alone = torch.arange(self.num_joints, device=end.device) == end[:, None]
        return torch.where(self._uniform(generator, batch, 1) < 0.6, alone, some)

    def _joints(self, generator: torch.Generator | None, batch: int) -> Tensor:
        """Single joints' positions with the root's ground position and height; in half of windows also rotations."""
        joints = self._some_joints(generator, batch)
        groups = self._only(self.ground, batch) | self._only(self.height, batch)
        groups = torch.cat([groups[:, : self.position], joints[:, 1:], groups[:, self.rotation :]], dim=1)
        turned = joints & (self._uniform(generator, batch, 1) < 0.5)
        return torch.cat([groups[:, : self.rotation], turned], dim=1)

    def _rotations(self, generator: torch.Generator | None, batch: int) -> Tensor:
        """Single joints' rotations and nothing else."""
        joints = self._some_joints(generator, batch)
        none = torch.zeros(batch, self.rotation, dtype=torch.bool, device=joints.device)
        return torch.cat([none, joints], dim=1)


def skeleton_head(skeleton: object) -> int:
    """The index of the joint called Head, or of the last joint if there is none."""
    names: tuple[str, ...] = skeleton.joint_names  # type: ignore[attr-defined]
    return names.index("Head") if "Head" in names else len(names) - 1
