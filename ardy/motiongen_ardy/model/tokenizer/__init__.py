"""The tokenizer: body features <-> latents, one latent for a patch of frames."""

from motiongen_ardy.model.tokenizer.explicit import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer, build_tokenizer

__all__ = ["ExplicitBody", "Tokenizer", "build_tokenizer"]
