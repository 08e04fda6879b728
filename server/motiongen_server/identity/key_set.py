"""An issuer's public keys, as it publishes them: a JSON Web Key Set (RFC 7517)."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from jwt import PyJWK
from jwt.exceptions import PyJWTError

_log = logging.getLogger(__name__)

_WITH_RSA = ("RS", "PS")


@dataclass(frozen=True)
class Key:
    """told: the key's JSON as published, by which keys are compared. read: PyJWT's object for it."""

    told: Mapping[str, Any]
    read: PyJWK = field(compare=False)

    def checks(self, allowed: Sequence[str]) -> tuple[Any, list[str]]:
        """What PyJWT is to check a signature with, and which of the allowed algorithms it may use.

        A key with `alg` is for that algorithm only. PyJWT assumes RS256 for an RSA key without `alg`, though it may be
        for any RSA algorithm (RFC 7517, 4.4). For keys of other types the curve determines the algorithm.
        """
        if self.told.get("alg") or self.read.key_type != "RSA":
            return self.read, list(allowed)
        return self.read.key, [name for name in allowed if name.startswith(_WITH_RSA)]


KeysById: TypeAlias = dict[str, Key]


def keys_of(document: object) -> KeysById:
    """The keys of a set that tokens may be signed with; those that cannot be read are skipped.

    Raises ValueError if the document is not a set of keys.
    """
    keys = document.get("keys") if isinstance(document, Mapping) else None
    if not isinstance(keys, list):
        raise ValueError("it is not a set of keys; it must be an object with a list of `keys` (RFC 7517)")
    found: KeysById = {}
    odd: list[str] = []
    for told in keys:
        # A shared (symmetric) key or an encryption key must never validate a token; other entries are not for us.
        if not isinstance(told, Mapping) or told.get("kty") == "oct" or told.get("use", "sig") != "sig":
            continue
        try:
            found[str(told.get("kid", ""))] = Key(told, PyJWK(dict(told)))
        except PyJWTError as error:
            _log.debug("a key is skipped: %s", error)
        except Exception as error:  # whatever untrusted JSON makes PyJWT raise, the other keys of the set stay valid
            odd.append(f"{str(told.get('kid', ''))[:64]!r} ({type(error).__name__})")
    if odd:
        _log.warning("invalid keys are skipped (RFC 7517): %s", ", ".join(odd[:8]))
    return found


def is_told(keys: Mapping[str, Key], key: Key) -> bool:
    """Whether a key is among these, also under another name or with other attributes."""
    if keys.get(str(key.told.get("kid", ""))) == key:  # nearly always
        return True
    return any(each.read.key == key.read.key for each in keys.values())


def find_key(keys: Mapping[str, Key], key_id: str) -> Key | None:
    """The key with that id; if `key_id` is "", the only key there is."""
    if not key_id and len(keys) == 1:
        return next(iter(keys.values()))
    return keys.get(key_id)
