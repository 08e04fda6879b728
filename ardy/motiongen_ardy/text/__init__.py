"""Text encoders: prompt -> one vector, which the denoiser takes as it is; a blank prompt gives a zero vector."""

from motiongen_ardy.text.encoder import (
    TextEncoder,
    TextEncoderChanged,
    TextEncoderUnavailable,
    TextRefused,
    TextWidthMismatch,
    UnknownTextEncoder,
    Vectors,
    check_width,
)
from motiongen_ardy.text.hashed import HashedTextEncoder
from motiongen_ardy.text.loading import load_text_encoder
from motiongen_ardy.text.static import StaticTextEncoder, built_in_text_folder

__all__ = [
    "HashedTextEncoder",
    "StaticTextEncoder",
    "TextEncoder",
    "TextEncoderChanged",
    "TextEncoderUnavailable",
    "TextRefused",
    "TextWidthMismatch",
    "UnknownTextEncoder",
    "Vectors",
    "built_in_text_folder",
    "check_width",
    "load_text_encoder",
]
