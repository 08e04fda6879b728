"""Callers: from what a call shows to who it is, and whether that still holds."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import (
    ANYBODY,
    Caller,
    Role,
    credentials_expired,
    credentials_invalid,
    credentials_missing,
    credentials_revoked,
    role_missing,
)
from motiongen_server.identity.tenants import Tenant, Tenants
from motiongen_server.identity.tokens import UNKNOWN, number_of
from motiongen_server.identity.watched import Watched

AUTHORIZATION = "authorization"
_SCHEME = "bearer "
_NAMES = ("x509_common_name", "x509_subject_alternative_name")

Metadata = Iterable[tuple[str, str | bytes]]
AuthContext = Mapping[str, Iterable[bytes]]


class Callers:
    """Without tenants, everybody who gets through TLS may call. A token is asked before a certificate.

    tenants: as their file says at present. wall: seconds since 1970.
    """

    def __init__(self, tenants: Watched[Tenants] | None = None, wall: Callable[[], float] = time.time) -> None:
        self._tenants = tenants
        self._wall = wall

    def identify(self, metadata: Metadata, connection: AuthContext, role: Role = Role.MOTION) -> Caller:
        """Who calls. connection: what gRPC says of it. Raises StreamRefused where it may not do what the role may."""
        authorization = next((text for key, text in metadata if key.lower() == AUTHORIZATION), "")
        return self.of_header(str(authorization), role, certificate_names(connection))

    def of_header(self, authorization: str, role: Role, certificates: Sequence[str] = ()) -> Caller:
        """The same by the header of that name, and the names of the client's certificate."""
        if self._tenants is None:
            return Caller(credential=f"certificate {certificates[0]!r}") if certificates else ANYBODY
        self._tenants.look()
        caller = self._find(authorization, certificates, self._tenants.value)
        if role not in caller.roles:
            raise role_missing(role)
        return caller

    def _find(self, authorization: str, certificates: Sequence[str], tenants: Tenants) -> Caller:
        if authorization:
            return self._of_token(authorization, tenants)
        for name in certificates:
            tenant = tenants.by_certificate.get(name)
            if tenant is not None:
                return _caller(tenant, f"certificate {name!r}", None)
        raise credentials_invalid() if certificates else credentials_missing()

    def _of_token(self, authorization: str, tenants: Tenants) -> Caller:
        if not authorization.lower().startswith(_SCHEME):
            raise credentials_missing()
        token = authorization[len(_SCHEME) :].strip()
        number = number_of(token)
        tenant, known = tenants.by_token.get(number or "", (None, None))
        is_right = (known.hash if known is not None else UNKNOWN).is_of(token)
        if tenant is None or known is None or not is_right:
            raise credentials_invalid()
        if known.expires_at is not None and known.expires_at <= self._wall():
            raise credentials_expired()
        return _caller(tenant, f"token {number}", known.expires_at)

    # ---- afterwards -------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """See whether the tenants' file has changed."""
        if self._tenants is not None:
            self._tenants.look()

    def lapse(self, caller: Caller) -> StreamRefused | None:
        """Why a caller may not go on, if so, by what is known since the last look."""
        if caller.expires_at is not None and caller.expires_at <= self._wall():
            return credentials_expired()
        if self._tenants is None or not caller.tenant:
            return None
        tenant = self._tenants.value.by_name.get(caller.tenant)
        if tenant is None or caller.roles - tenant.roles:
            return credentials_revoked()
        kind, _, name = caller.credential.partition(" ")
        there = (
            [f"{token.hash.number}" for token in tenant.tokens] if kind == "token" else map(repr, tenant.certificates)
        )
        return None if name in there else credentials_revoked()

    def remaining_s(self, caller: Caller) -> float | None:
        """Seconds until the caller's credentials expire; None where they do not."""
        return None if caller.expires_at is None else caller.expires_at - self._wall()


def certificate_names(connection: AuthContext) -> list[str]:
    """The names that a client's certificate, which an authority of ours has signed, has; none where it showed none."""
    return [name.decode(errors="replace") for key in _NAMES for name in connection.get(key, ())]


def _caller(tenant: Tenant, credential: str, expires_at: float | None) -> Caller:
    return Caller(tenant.name, credential, tenant.roles, expires_at, tenant.quota)
