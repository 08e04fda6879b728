"""Take: one character to be generated for evaluation, as a script of prompts, velocities and constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from motiongen_ardy.core.constraint import Targets
from motiongen_ardy.core.representation import heading_angle
from motiongen_ardy.core.skeleton import Skeleton


@dataclass(frozen=True)
class Steer:
    """A velocity in force from `frame` on: metres a second in the world; heading in radians, None for any.

    keep_prompt: use the take's own prompt, not that of the model's gait for this speed.
    """

    frame: int
    x: float
    z: float
    heading: float | None = None
    hold_frames: int = 1_000_000
    keep_prompt: bool = False


@dataclass(frozen=True)
class Take:
    """One character's script.

    case and seed identify it in the figures; takes of one case differ only by seed. num_frames includes the history.
    prompts: (first frame, text), the first at 0, "" for none. history: (H, D), features in natural units, world frame,
    H a multiple of 4. targets: constraints by frame, known from the first generated frame on. start: x, z, heading of a
    character without history.
    """

    case: str
    seed: int
    num_frames: int
    prompts: tuple[tuple[int, str], ...]
    group: str = "moving"
    history: Tensor | None = None
    targets: Targets | None = None
    steers: tuple[Steer, ...] = ()
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def history_len(self) -> int:
        return 0 if self.history is None else len(self.history)

    def prompt_at(self, frame: int) -> str:
        """The prompt in force at a frame."""
        return [text for first, text in self.prompts if first <= frame][-1]

    def steer_at(self, frame: int, after: int = 0) -> Steer | None:
        """The velocity in force at a frame, or one that ended at most `after` frames before it."""
        begun = [steer for steer in self.steers if steer.frame <= frame]  # each replaces the one before it, for good
        return begun[-1] if begun and frame < begun[-1].frame + begun[-1].hold_frames + after else None

    def next_change(self, frame: int) -> int:
        """The first frame after `frame` at which an event takes effect; num_frames if there is none."""
        changes = [first for first, _ in self.prompts] + [steer.frame for steer in self.steers]
        replaced_at = [steer.frame for steer in self.steers[1:]] + [self.num_frames]
        changes += [
            min(steer.frame + steer.hold_frames, later) for steer, later in zip(self.steers, replaced_at, strict=False)
        ]
        return min((change for change in changes if frame < change < self.num_frames), default=self.num_frames)


@dataclass(frozen=True)
class Result:
    """The motion of a take. features: (T, D) in natural units; positions: (T, J, 3), metres, by forward kinematics.

    rotations: (T, J, 3, 3), global.
    """

    take: Take
    features: Tensor
    positions: Tensor
    rotations: Tensor
    window_starts: tuple[int, ...]

    @property
    def root(self) -> Tensor:
        """(T, 2), x and z in metres."""
        return self.positions[:, 0, [0, 2]]

    def facing(self, skeleton: Skeleton) -> Tensor:
        """(T) radians about +Y, from the hips."""
        return heading_angle(skeleton, self.positions)


def direction(angle: Tensor | float) -> Tensor:
    """The unit ground vector (..., 2), x and z, of an angle about +Y in radians."""
    angle = torch.as_tensor(angle, dtype=torch.float32)
    return torch.stack([angle.sin(), angle.cos()], dim=-1)


def result_frames(result: Result, first: int) -> Result:
    """The frames of a result from `first` on; negative: counted from the end."""
    return replace(
        result,
        features=result.features[first:],
        positions=result.positions[first:],
        rotations=result.rotations[first:],
        window_starts=(),
    )
