"""The tokenizer: body features <-> latents, one latent for a patch of frames."""

from ardy.tokenizer.model import Tokenizer, build_tokenizer

__all__ = ["Tokenizer", "build_tokenizer"]
