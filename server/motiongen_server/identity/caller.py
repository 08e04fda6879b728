"""Caller: who makes a call, as far as the gateway knows, and the refusals of calls because of their credentials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

import grpc

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.key_set import Key


class Role(StrEnum):
    """What a tenant may do."""

    MOTION = "motion"
    """Open streams, ask for clips and the catalogue."""
    ADMIN = "admin"
    """Load and unload models."""
    METRICS = "metrics"
    """Read the metrics."""
    TEXT = "text"
    """Have the encoder service encode texts."""


CREDENTIALS_EXPIRED = "CREDENTIALS_EXPIRED"
DEFAULT_ROLES = frozenset({Role.MOTION})


@dataclass(frozen=True)
class Caller:
    """tenant: its name, "" for anybody. credential: what the caller presented, in words for logs; never the secret.

    expires_at: when the credential expires, in seconds since 1970; None: never. quota: limits of its tenant that differ
    from those of an address, by the names of `rpc.limits.PeerLimits`. signed_by: for a signed token, the issuer (the
    claim `iss`) and the key; None for a token from the tenants' file.
    """

    tenant: str = ""
    credential: str = "nothing"
    roles: frozenset[Role] = DEFAULT_ROLES
    expires_at: float | None = None
    quota: Mapping[str, float] = field(default_factory=dict)
    signed_by: tuple[str, Key] | None = None


ANYBODY = Caller()


def credentials_missing() -> StreamRefused:
    message = "the call carries no token; send `authorization: Bearer TOKEN` in its metadata"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_MISSING", message)


def credentials_invalid() -> StreamRefused:
    message = "the credentials are not known to this server; ask its operator for a token"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_INVALID", message)


def credentials_repeated(num: int) -> StreamRefused:
    message = f"the call carries {num} entries `authorization` in its metadata; send only one"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_INVALID", message)


def credentials_not_for_us(audience: str) -> StreamRefused:
    message = f"the token is for another service; ask its issuer for one whose audience is {audience}"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_INVALID", message)


def credentials_too_early(leeway_s: float) -> StreamRefused:
    """For a signed token: the clock of its issuer or of this machine is wrong, or the token is meant for later."""
    message = (
        "the token is not valid yet, by its `nbf` or `iat` and this server's clock; use it later, or set the clocks of "
        f"server and issuer, which may differ by {leeway_s:g} s"
    )
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_INVALID", message)


def tenant_unknown(name: str) -> StreamRefused:
    message = f"the token names the tenant {name[:64]!r}, which its issuer may not name here; ask the server's operator"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_INVALID", message)


def keys_unavailable() -> StreamRefused:
    message = "the token cannot be checked, since its issuer's keys cannot be fetched; try again a little later"
    return StreamRefused(grpc.StatusCode.UNAVAILABLE, "KEYS_UNAVAILABLE", message, retry_after_s=5.0)


def credentials_expired() -> StreamRefused:
    message = "the credentials have expired; get new ones, and resume the sessions with them"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_EXPIRED", message)


def credentials_revoked() -> StreamRefused:
    message = "the credentials were revoked; ask the server's operator for others"
    return StreamRefused(grpc.StatusCode.UNAUTHENTICATED, "CREDENTIALS_REVOKED", message)


def role_missing(role: Role) -> StreamRefused:
    message = f"these credentials do not allow this; it requires a tenant with the role {role.value!r}"
    return StreamRefused(grpc.StatusCode.PERMISSION_DENIED, "ROLE_MISSING", message)
