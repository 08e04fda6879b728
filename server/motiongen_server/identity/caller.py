"""Caller: who a call comes from, as far as the gateway knows, and why a call is refused for that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import grpc

from motiongen_server.errors import StreamRefused


class Role(StrEnum):
    """What a tenant may do."""

    MOTION = "motion"
    """Open streams, ask for clips and the catalogue."""
    ADMIN = "admin"
    """Load and unload models."""
    METRICS = "metrics"
    """Read the metrics."""
    TEXT = "text"
    """Have texts encoded, by the encoder service."""


CREDENTIALS_EXPIRED = "CREDENTIALS_EXPIRED"
DEFAULT_ROLES = frozenset({Role.MOTION})


@dataclass(frozen=True)
class Caller:
    """tenant: its name, "" for anybody. credential: what it showed, in words for logs; never the secret.

    expires_at: when that ends, in seconds of the wall clock since 1970; None: never. quota: limits of its tenant that
    differ from those of an address, by the names of `rpc.limits.PeerLimits`. signed_by: the issuer and the
    key of a token that is not of the tenants' file.
    """

    tenant: str = ""
    credential: str = "nothing"
    roles: frozenset[Role] = DEFAULT_ROLES
    expires_at: float | None = None
    quota: Mapping[str, float] = field(default_factory=dict)
    signed_by: tuple[str, str] | None = None


ANYBODY = Caller()


def _unauthenticated(reason: str, message: str) -> StreamRefused:
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, reason, message)


def credentials_missing() -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_MISSING", "the call carries no token; send `authorization: Bearer TOKEN` in its metadata"
    )


def credentials_invalid() -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_INVALID", "the credentials are not known to this server; ask its operator for a token"
    )


def credentials_not_for_us(audience: str) -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_INVALID", f"the token is for another service; ask its issuer for one whose audience is {audience}"
    )


def tenant_unknown(name: str) -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_INVALID",
        f"the token names the tenant {name[:64]!r}, whom its issuer may not name here; ask the server's operator",
    )


def keys_unavailable() -> StreamRefused:
    message = "the token cannot be checked, since its issuer's keys cannot be fetched; try again a little later"
    return StreamRefused(grpc.StatusCode.UNAVAILABLE, "KEYS_UNAVAILABLE", message, retry_after_s=5.0)


def credentials_expired() -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_EXPIRED", "the credentials have expired; get new ones, and resume the sessions with them"
    )


def credentials_revoked() -> StreamRefused:
    return _unauthenticated(
        "CREDENTIALS_REVOKED", "the credentials were taken back; ask the server's operator for others"
    )


def role_missing(role: Role) -> StreamRefused:
    message = f"these credentials do not allow this; it takes a tenant with the role {role.value!r}"
    return StreamRefused(grpc.StatusCode.PERMISSION_DENIED, "ROLE_MISSING", message)
