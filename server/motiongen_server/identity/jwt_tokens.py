"""Tokens that an issuer has signed: read, and checked against its keys and what is asked of its claims."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import jwt
from jwt import PyJWK
from jwt.exceptions import ExpiredSignatureError, InvalidAudienceError, PyJWTError

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import (
    credentials_expired,
    credentials_invalid,
    credentials_not_for_us,
    keys_unavailable,
)
from motiongen_server.identity.issuers import ALGORITHMS, Issuer
from motiongen_server.identity.keys import Keys, KeysUnavailable

MOST_CHARACTERS = 8_192
MOST_REMEMBERED = 1_024


@dataclass(frozen=True)
class Unchecked:
    """What a token says of itself, which anybody may have written. issuer: whose it claims to be."""

    token: str = field(repr=False)
    issuer: str
    key_id: str


@dataclass(frozen=True)
class Checked:
    """What an issuer says. tenant: the claim that it is asked for; expires_at: seconds since 1970, leeway included."""

    tenant: str
    expires_at: float


class TokenChecks:
    """Tokens that were checked, so that it is not done again for every call: it takes 0.1 ms of the event loop.

    A check holds while its issuer's entry and key are the same objects, so it is made anew whenever keys were fetched.
    """

    def __init__(self, most: int = MOST_REMEMBERED) -> None:
        self._most = most
        self._held: OrderedDict[str, tuple[Issuer, PyJWK | None, Checked]] = OrderedDict()

    def known(self, said: Unchecked, issuer: Issuer, keys: Keys) -> Checked | None:
        """What a check of the token has found that still holds; whether it has expired is not looked at."""
        held = self._held.get(said.token)
        if held is None or held[0] != issuer or held[1] is None or held[1] is not _find(keys, said.key_id):
            return None
        self._held.move_to_end(said.token)
        return held[2]

    def check(self, said: Unchecked, issuer: Issuer, keys: Keys) -> Checked:
        """What the issuer says. Raises StreamRefused for a token that does not hold."""
        found = self.known(said, issuer, keys)
        if found is None:
            found = checked(said, issuer, keys)
            self._held[said.token] = issuer, _find(keys, said.key_id), found
            if len(self._held) > self._most:
                self._held.popitem(last=False)
        return found


def _find(keys: Keys, key_id: str) -> PyJWK | None:
    try:
        return keys.find(key_id)
    except KeysUnavailable:
        return None


@lru_cache(maxsize=256)
def unchecked(token: str) -> Unchecked | None:
    """None for what is no token of that kind. Asked several times for each call, hence the cache."""
    if token.count(".") != 2 or len(token) > MOST_CHARACTERS:
        return None
    try:
        header = jwt.get_unverified_header(token)
        claims = jwt.decode(token, options={"verify_signature": False}, algorithms=list(ALGORITHMS))
    except (PyJWTError, ValueError, RecursionError):
        return None
    issuer, key_id = claims.get("iss"), header.get("kid", "")
    return Unchecked(token, issuer, key_id) if isinstance(issuer, str) and isinstance(key_id, str) else None


def checked(said: Unchecked, issuer: Issuer, keys: Keys) -> Checked:
    """Raises StreamRefused for a token that does not hold."""
    try:
        key = keys.find(said.key_id)
    except KeysUnavailable:
        raise keys_unavailable() from None
    if key is None:
        raise credentials_invalid()
    try:
        claims: Mapping[str, Any] = jwt.decode(
            said.token,
            key,
            algorithms=list(issuer.algorithms),
            audience=list(issuer.audience),
            issuer=issuer.issuer,
            leeway=issuer.leeway_s,
            options={"require": ["exp", "iss", "aud"], "enforce_minimum_key_length": True},
        )
    except ExpiredSignatureError:
        raise credentials_expired() from None
    except InvalidAudienceError:
        raise credentials_not_for_us(", ".join(issuer.audience)) from None
    except (PyJWTError, ValueError, TypeError):
        raise credentials_invalid() from None
    tenant = claims.get(issuer.tenant_claim)
    if not isinstance(tenant, str) or not tenant:
        raise claim_missing(issuer.tenant_claim)
    return Checked(tenant, int(claims["exp"]) + issuer.leeway_s)


def claim_missing(claim: str) -> StreamRefused:
    """The token holds, and does not say whose it is."""
    refusal = credentials_invalid()
    message = f"the token has no claim {claim!r} that names a tenant; have its issuer put it in"
    return StreamRefused(refusal.code, refusal.reason, message)
