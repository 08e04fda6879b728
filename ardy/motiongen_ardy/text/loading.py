"""Loads a text encoder by its name."""

from __future__ import annotations

from pathlib import Path

from motiongen_ardy.text.encoder import TextEncoder, UnknownTextEncoder, check_width
from motiongen_ardy.text.hashed import HashedTextEncoder
from motiongen_ardy.text.static import StaticTextEncoder, built_in_text_folder

FORMS = "static, hashed, llm2vec, gradio:URL, prompts:FILE, or a folder that model2vec wrote"


def load_text_encoder(
    name: str,
    width: int | None = None,
    device: str = "cpu",
    precision: str = "bfloat16",
    timeout_s: float = 30.0,
) -> TextEncoder:
    """The encoder called `name`, one of `FORMS`. width: of the model's text input; required for hashed.

    device, precision: of llm2vec. timeout_s: for one prompt at a remote encoder. Raises UnknownTextEncoder,
    TextWidthMismatch if the encoder's vectors are not `width` wide, and TextEncoderUnavailable.
    """
    if name == "hashed":
        if width is None:
            raise UnknownTextEncoder("the text encoder hashed fits any width, and none is given")
        return HashedTextEncoder(width)
    encoder = _load(name, device, precision, timeout_s)
    if width is not None:
        check_width(name, encoder.width, width)
    return encoder


def _load(name: str, device: str, precision: str, timeout_s: float) -> TextEncoder:
    kind, separator, place = name.partition(":")
    if name == "llm2vec":
        from motiongen_ardy.text.llm2vec import Llm2VecEncoder, find_folders

        return Llm2VecEncoder(find_folders(), device, precision)
    if separator and kind == "gradio":
        from motiongen_ardy.text.gradio import GradioTextEncoder

        return GradioTextEncoder(place, timeout_s)
    if separator and kind == "prompts":
        from motiongen_ardy.text.prompt_file import PromptFileEncoder, read_prompt_file

        return PromptFileEncoder(read_prompt_file(Path(place)))
    folder = built_in_text_folder() if name == "static" else Path(name)
    if not (folder / "model.safetensors").is_file():
        raise UnknownTextEncoder(f"no text encoder {name!r}; use {FORMS}")
    return StaticTextEncoder(folder)
