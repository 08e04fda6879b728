"""Tokens that an issuer has signed: read, and checked against its keys and what is asked of its claims."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import jwt
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


@dataclass(frozen=True)
class Unchecked:
    """What a token says of itself, which anybody may have written. issuer: whose it claims to be."""

    token: str
    issuer: str
    key_id: str


@dataclass(frozen=True)
class Checked:
    """What an issuer says. tenant: the claim that it is asked for; expires_at: seconds since 1970, leeway included."""

    tenant: str
    expires_at: float


def unchecked(token: str) -> Unchecked | None:
    """None for what is no token of that kind."""
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
