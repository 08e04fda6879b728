"""Signed tokens (JSON Web Tokens): parsed, and checked against the issuer's keys and its entry's requirements."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import jwt
from jwt.exceptions import ExpiredSignatureError, ImmatureSignatureError, InvalidAudienceError, PyJWTError

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import (
    credentials_expired,
    credentials_invalid,
    credentials_not_for_us,
    credentials_too_early,
    keys_unavailable,
)
from motiongen_server.identity.issuers import Issuer
from motiongen_server.identity.key_set import Key
from motiongen_server.identity.keys import Keys, KeysUnavailable

MOST_CHARACTERS = 8_192
MOST_REMEMBERED = 1_024


@dataclass(frozen=True)
class Unchecked:
    """What a token says before it is checked; anybody may have written it. issuer: the one that it names."""

    token: str = field(repr=False)
    issuer: str
    key_id: str


@dataclass(frozen=True)
class Checked:
    """What a valid token says. tenant: the value of `tenant_claim`. expires_at: seconds since 1970, plus the leeway.

    key: the key that its signature was checked with.
    """

    tenant: str
    expires_at: float
    key: Key


class TokenChecks:
    """A cache of checked tokens, since checking one takes 0.1 ms of the event loop.

    A result stays valid while the issuer's entry and its key are the same, also if the key is fetched again.
    """

    def __init__(self, most: int = MOST_REMEMBERED) -> None:
        self._most = most
        self._held: OrderedDict[str, tuple[Unchecked, Issuer, Checked]] = OrderedDict()

    def said(self, token: str) -> Unchecked | None:
        """What a token says, if it is in the cache; does not parse it."""
        held = self._held.get(token)
        return None if held is None else held[0]

    def known(self, said: Unchecked, issuer: Issuer, keys: Keys) -> Checked | None:
        """The cached result of a token's check, if still valid. It does not consider whether the token has expired."""
        held = self._held.get(said.token)
        if held is None or held[1] != issuer or held[2].key != _find(keys, said.key_id):
            return None
        self._held.move_to_end(said.token)
        return held[2]

    def check(self, said: Unchecked, issuer: Issuer, keys: Keys) -> Checked:
        """Check a token, or take the result from the cache. Raises StreamRefused if it is not valid."""
        found = self.known(said, issuer, keys)
        if found is None:
            found = checked(said, issuer, keys)
            self._held[said.token] = said, issuer, found
            if len(self._held) > self._most:
                self._held.popitem(last=False)
        return found


def _find(keys: Keys, key_id: str) -> Key | None:
    try:
        return keys.find(key_id)
    except KeysUnavailable:
        return None


def may_be_signed(token: str) -> bool:
    """Whether it looks like a signed token, and is short enough to be parsed."""
    return len(token) <= MOST_CHARACTERS and token.count(".") == 2


@lru_cache(maxsize=256)
def unchecked(token: str) -> Unchecked | None:
    """What a signed token says; None if it is not one. Cached because it is needed several times for each call."""
    if not may_be_signed(token):
        return None
    try:
        read = jwt.decode_complete(token, options={"verify_signature": False})
    except (PyJWTError, ValueError, RecursionError):
        return None
    issuer, key_id = read["payload"].get("iss"), read["header"].get("kid", "")
    return Unchecked(token, issuer, key_id) if isinstance(issuer, str) and isinstance(key_id, str) else None


def checked(said: Unchecked, issuer: Issuer, keys: Keys) -> Checked:
    """Check a token. Raises StreamRefused if it is not valid."""
    try:
        key = keys.find(said.key_id)
    except KeysUnavailable:
        raise keys_unavailable() from None
    if key is None:
        raise credentials_invalid()
    checked_with, algorithms = key.checks(issuer.algorithms)
    try:
        claims: Mapping[str, Any] = jwt.decode(
            said.token,
            checked_with,
            algorithms=algorithms,
            audience=list(issuer.audience),
            issuer=issuer.issuer,
            leeway=issuer.leeway_s,
            options={"require": ["exp", "iss", "aud"], "enforce_minimum_key_length": True},
        )
        expires_at = float(int(claims["exp"])) + issuer.leeway_s
    except ExpiredSignatureError:
        raise credentials_expired() from None
    except InvalidAudienceError:
        raise credentials_not_for_us(", ".join(issuer.audience)) from None
    except ImmatureSignatureError:
        raise credentials_too_early(issuer.leeway_s) from None
    except (PyJWTError, ValueError, TypeError, OverflowError):
        raise credentials_invalid() from None
    tenant = claims.get(issuer.tenant_claim)
    if not isinstance(tenant, str) or not tenant:
        raise claim_missing(issuer.tenant_claim)
    return Checked(tenant, expires_at, key)


def claim_missing(claim: str) -> StreamRefused:
    """For a valid token that names no tenant."""
    refusal = credentials_invalid()
    message = f"the token has no claim {claim!r} that names a tenant; have its issuer add it"
    return StreamRefused(refusal.code, refusal.reason, message)
