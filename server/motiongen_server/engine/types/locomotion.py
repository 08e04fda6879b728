"""Gaits: a model's prompts for moving at a speed in a direction."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from motiongen_server.engine.types.arrays import Float32Array


class Direction(IntEnum):
    """The direction of movement relative to the character's heading."""

    FORWARD = 0
    LEFT = 1
    BACKWARD = 2
    RIGHT = 3


@dataclass(frozen=True, slots=True, eq=False)
class Gait:
    """A prompt for moving in a direction at from_mps metres per second or more. embedding: (E,) float32."""

    name: str
    text: str
    from_mps: float
    direction: Direction
    embedding: Float32Array

    @property
    def quarter(self) -> int:
        """The direction as a quarter turn, as `motiongen_ardy.locomotion` counts them."""
        return int(self.direction)
