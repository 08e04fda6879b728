"""The tokenizer: body features <-> latents, one latent for a patch of frames."""

from ardy.tokenizer.explicit import ExplicitBody
from ardy.tokenizer.model import Tokenizer, build_tokenizer

__all__ = ["ExplicitBody", "Tokenizer", "build_tokenizer"]
