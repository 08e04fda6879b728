"""The tokenizer: body features <-> latents, one latent per patch of frames."""

from motiongen_ardy.model.tokenizer.explicit import ExplicitBody
from motiongen_ardy.model.tokenizer.model import Tokenizer, build_tokenizer

__all__ = ["ExplicitBody", "Tokenizer", "build_tokenizer"]
