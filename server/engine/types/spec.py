"""What a session starts with."""

from __future__ import annotations

from dataclasses import dataclass

from server.engine.types.conditions import Constraint, Prompt
from server.engine.types.names import Priority, SessionKey


@dataclass(frozen=True, slots=True)
class Guidance:
    """The weights of the two guidance terms; 0 turns a term off."""

    text: float
    constraint: float


@dataclass(frozen=True, slots=True)
class StartPose:
    """Where a character stands before its first frame: metres on the ground, and heading in radians, 0 toward +Z."""

    x: float = 0.0
    z: float = 0.0
    heading: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SessionSpec:
    """Everything a session starts with. lookahead: frames that may be sent beyond the playhead."""

    session: SessionKey
    seed: int
    model_id: str
    priority: Priority
    lookahead: int
    denoise_steps: int
    guidance: Guidance
    start_pose: StartPose = StartPose()
    prompts: tuple[Prompt, ...] = ()
    constraints: tuple[Constraint, ...] = ()
