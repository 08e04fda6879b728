"""Presets: prompts that a server knows beforehand, with their embeddings."""

from __future__ import annotations

from dataclasses import dataclass

from motiongen_server.engine.types import Float32Array


@dataclass(frozen=True, slots=True, eq=False)
class Preset:
    """A prompt with an id. embedding: (E,) float32, from the encoder that the model was trained with.

    description: the motion to expect, in words for users.
    """

    preset_id: str
    text: str
    embedding: Float32Array
    description: str = ""
