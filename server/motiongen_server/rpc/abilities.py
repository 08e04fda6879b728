"""Abilities: what a model was trained for: forms of constraints, presets, gaits, and the subjects of its captions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from motiongen_server.engine.types import Direction, Float32Array


class FormSupport(IntEnum):
    """Whether a model was trained for a form; the numbers are those of the protocol."""

    TRAINED = 1
    UNTRAINED = 2
    REFUSED = 3


@dataclass(frozen=True, slots=True)
class PresetText:
    """A prompt that a model's checkpoint recommends, not encoded. description: the motion to expect."""

    preset_id: str
    text: str
    description: str


@dataclass(frozen=True, slots=True)
class GaitText:
    """A gait of a model's checkpoint, not encoded; the fields are those of `Gait`.

    to_mps: beyond this speed, characters' feet glide; infinity: nothing is claimed.
    """

    name: str
    text: str
    from_mps: float
    direction: Direction
    to_mps: float = math.inf


@dataclass(frozen=True, slots=True, eq=False)
class PromptDomain:
    """Which prompts are near the captions that a model was trained on, for vectors of one text encoder.

    mean: (E,), of the captions; directions: (N, E), unit vectors from it to captions that represent the others.
    threshold: the distance above which a prompt is outside.
    """

    text_encoder: str
    mean: Float32Array
    directions: Float32Array
    threshold: float

    def distance(self, embedding: Float32Array) -> float:
        """One minus the cosine between a prompt's direction from the mean and the nearest caption's: 0 to 2."""
        offset = embedding / max(float(np.linalg.norm(embedding)), 1e-12) - self.mean
        cosines = self.directions @ (offset / max(float(np.linalg.norm(offset)), 1e-12))
        return 1.0 - float(cosines.max())

    def is_outside(self, embedding: Float32Array) -> bool:
        """Whether a prompt is farther from all captions than prompts of the domain are."""
        return self.distance(embedding) > self.threshold


@dataclass(frozen=True, slots=True, eq=False)
class Abilities:
    """What is known of a model's training. Empty: nothing is claimed, everything is accepted, without warnings.

    known_motions: what the captions are about, in words. domain: None if prompts cannot be judged.
    """

    forms: Mapping[str, FormSupport] = field(default_factory=dict)
    presets: Sequence[PresetText] = ()
    gaits: Sequence[GaitText] = ()
    known_motions: Sequence[str] = ()
    domain: PromptDomain | None = None

    def fastest_mps(self, direction: Direction) -> float:
        """The speed up to which characters step, not glide, in a direction relative to where they face; infinity:
        nothing is claimed."""
        fastest = {gait.direction: gait.to_mps for gait in sorted(self.gaits, key=lambda gait: gait.from_mps)}
        return fastest.get(direction, math.inf)


NOTHING_CLAIMED = Abilities()
