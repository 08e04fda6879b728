"""Public keys of an issuer, as it tells them: a JSON Web Key Set (RFC 7517)."""

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
    """Two are the same where the issuer tells the same of them. told: its JSON. read: what PyJWT makes of that."""

    told: Mapping[str, Any]
    read: PyJWK = field(compare=False)

    def checks(self, allowed: Sequence[str]) -> tuple[Any, list[str]]:
        """What PyJWT checks a signature with, and by which of the algorithms that are allowed.

        A key whose `alg` is told is for that one alone. PyJWT takes an RSA key without it to be for RS256, though any
        of RSA may be meant (RFC 7517, 4.4); of other kinds the curve says which.
        """
        if self.told.get("alg") or self.read.key_type != "RSA":
            return self.read, list(allowed)
        return self.read.key, [name for name in allowed if name.startswith(_WITH_RSA)]


KeysById: TypeAlias = dict[str, Key]


def keys_of(document: object) -> KeysById:
    """The keys of a set that tokens may be signed with; those that are not understood are passed over.

    Raises ValueError where it is no set.
    """
    keys = document.get("keys") if isinstance(document, Mapping) else None
    if not isinstance(keys, list):
        raise ValueError("it is no set of keys; it must be an object with a list of `keys` (RFC 7517)")
    found: KeysById = {}
    odd: list[str] = []
    for told in keys:
        # A key that is shared, or to encrypt with, must not let a token pass; one of another kind is for others.
        if not isinstance(told, Mapping) or told.get("kty") == "oct" or told.get("use", "sig") != "sig":
            continue
        try:
            found[str(told.get("kid", ""))] = Key(told, PyJWK(dict(told)))
        except PyJWTError as error:
            _log.debug("a key is passed over: %s", error)
        except Exception as error:  # whatever PyJWT makes of JSON of others: the other keys of the set hold
            odd.append(f"{str(told.get('kid', ''))[:64]!r} ({type(error).__name__})")
    if odd:
        _log.warning("keys are passed over, which are none (RFC 7517): %s", ", ".join(odd[:8]))
    return found


def is_told(keys: Mapping[str, Key], key: Key) -> bool:
    """Whether a key is one of them, whatever is told of it besides; another may have got its name."""
    if keys.get(str(key.told.get("kid", ""))) == key:  # as it nearly always is
        return True
    return any(each.read.key == key.read.key for each in keys.values())


def find_key(keys: Mapping[str, Key], key_id: str) -> Key | None:
    """The key of that name; without one, the only key there is."""
    if not key_id and len(keys) == 1:
        return next(iter(keys.values()))
    return keys.get(key_id)
