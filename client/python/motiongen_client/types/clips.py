"""A clip, and how nearly it met its constraints."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_client.motion import Motion
from motiongen_client.types.answers import ModelWarning


@dataclass(frozen=True)
class Deviation:
    """The mean and the greatest error of one kind."""

    mean: float
    worst: float


@dataclass(frozen=True)
class Residual:
    """By how much a clip misses one constraint. None: the constraint asks for nothing of that kind.

    num_frames: frames of the constraint within the clip. heading_rad and rotation_rad are angles from 0 to pi. met:
    whether the greatest error of each kind is within its tolerance.
    """

    num_frames: int
    position_m: Deviation | None
    heading_rad: Deviation | None
    rotation_rad: Deviation | None
    met: bool = False


@dataclass(frozen=True, eq=False)
class Clip:
    """One sample of a clip. residuals: one for each constraint, in the order they were given.

    warnings: about prompts and constraints that the model was not trained for.
    """

    model_id: str
    seed: int
    denoise_steps: int
    motion: Motion
    residuals: tuple[Residual, ...]
    warnings: tuple[ModelWarning, ...] = ()
