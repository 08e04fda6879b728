"""Bearer tokens: made here, stored as salted hashes.

A token is `mg_NUMBER_SECRET`. Its secret has 256 random bits and cannot be guessed, so a fast hash is as good as a slow
one. With a slow one, strangers could keep the gateway busy by sending wrong tokens.
"""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass

_PREFIX = "mg"
_SCHEME = "sha256"
_NUMBER_BYTES = 6
_SECRET_BYTES = 32
_SALT_BYTES = 16
_TOKEN = re.compile(rf"{_PREFIX}_([0-9a-f]{{{2 * _NUMBER_BYTES}}})_[0-9a-f]{{{2 * _SECRET_BYTES}}}")
_HASH = re.compile(
    rf"{_SCHEME}:([0-9a-f]{{{2 * _NUMBER_BYTES}}}):([0-9a-f]{{{2 * _SALT_BYTES}}}):([0-9a-f]{{64}})", re.ASCII
)


@dataclass(frozen=True, slots=True)
class TokenHash:
    """What is stored of a token. number: its public part, by which the hash is found."""

    number: str
    salt: bytes
    digest: bytes

    @classmethod
    def parse(cls, text: str) -> TokenHash:
        """Raises ValueError."""
        match = _HASH.fullmatch(text)
        if match is None:
            raise ValueError("a token's hash is not one that `python -m motiongen_server.identity` prints")
        return cls(match[1], bytes.fromhex(match[2]), bytes.fromhex(match[3]))

    def __str__(self) -> str:
        return f"{_SCHEME}:{self.number}:{self.salt.hex()}:{self.digest.hex()}"

    def is_of(self, token: str) -> bool:
        """Whether this is the hash of `token`, compared in constant time."""
        return hmac.compare_digest(_digest(self.salt, token), self.digest)


UNKNOWN = TokenHash("", bytes(_SALT_BYTES), bytes(32))
"""The hash of no token. It is compared for unknown numbers: refusing one takes as long as refusing a wrong secret."""


def new_token() -> tuple[str, TokenHash]:
    """A new token, and its hash to be stored."""
    number = secrets.token_hex(_NUMBER_BYTES)
    token = f"{_PREFIX}_{number}_{secrets.token_hex(_SECRET_BYTES)}"
    salt = secrets.token_bytes(_SALT_BYTES)
    return token, TokenHash(number, salt, _digest(salt, token))


def number_of(token: str) -> str | None:
    """The public part of a token; None if it does not have the form of one."""
    match = _TOKEN.fullmatch(token)
    return None if match is None else match[1]


def _digest(salt: bytes, token: str) -> bytes:
    return hashlib.sha256(salt + token.encode()).digest()
