"""A clip, and how near it came to its constraints."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_client.motion import Motion
from motiongen_client.types.answers import ModelWarning


@dataclass(frozen=True)
class Deviation:
    """The mean and the worst of one kind of error."""

    mean: float
    worst: float


@dataclass(frozen=True)
class Residual:
    """How far a clip is from what one constraint asks for. None: it asks for nothing of that kind.

    num_frames: of the constraint, in the clip. heading_rad and rotation_rad are angles from 0 to pi. met: whether the
    worst of each kind is within its tolerance.
    """

    num_frames: int
    position_m: Deviation | None
    heading_rad: Deviation | None
    rotation_rad: Deviation | None
    met: bool = False


@dataclass(frozen=True, eq=False)
class Clip:
    """One sample of a clip. residuals: one for each constraint, in the order they were given.

    warnings: of prompts and constraints that the model was not trained for.
    """

    model_id: str
    seed: int
    denoise_steps: int
    motion: Motion
    residuals: tuple[Residual, ...]
    warnings: tuple[ModelWarning, ...] = ()
