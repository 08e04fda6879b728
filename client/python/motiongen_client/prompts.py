"""Prompts: a text, one of the server's presets, or the vector that a text encoder made of a text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

from numpy.typing import ArrayLike

from motiongen_client.errors import InvalidInput
from motiongen_client.types import as_array, check_text


@dataclass(frozen=True)
class Preset:
    """A prompt that the server knows beforehand, by its id in `Model.presets`. It needs no text encoder."""

    preset_id: str

    def __post_init__(self) -> None:
        check_text("preset_id", self.preset_id, "an id of Model.presets")
        if not self.preset_id:
            raise InvalidInput("preset_id", self.preset_id, "an id of Model.presets")


@dataclass(frozen=True, eq=False)
class TextEmbedding:
    """A prompt that is already encoded. values: (Model.text_width,), the vector that `text_encoder` made of a text.

    text_encoder: its name, which must be Model.text_encoder. text: what it says, for people; may be empty.
    """

    values: ArrayLike
    text_encoder: str
    text: str = ""

    def __post_init__(self) -> None:
        check_text("text_encoder", self.text_encoder, "the name in Model.text_encoder")
        check_text("text", self.text)
        object.__setattr__(self, "values", as_array("values", self.values, (None,)))


Prompt: TypeAlias = str | Preset | TextEmbedding


def prompt_name(prompt: Prompt) -> str:
    """How messages refer to a prompt."""
    match prompt:
        case Preset():
            return f"the preset {prompt.preset_id!r}"
        case TextEmbedding():
            return f"the embedding of {prompt.text!r}" if prompt.text else "an embedding"
        case _:
            return f"the prompt {prompt!r}"
