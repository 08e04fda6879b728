"""Callers: identifies the caller by the credentials of a call, and says whether they are still valid."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import replace

from motiongen_server.addresses import is_local
from motiongen_server.errors import StreamRefused
from motiongen_server.identity.caller import (
    ANYBODY,
    Caller,
    Role,
    credentials_expired,
    credentials_invalid,
    credentials_missing,
    credentials_repeated,
    credentials_revoked,
    role_missing,
    tenant_unknown,
)
from motiongen_server.identity.issuers import Issuer
from motiongen_server.identity.jwt_tokens import TokenChecks, Unchecked, may_be_signed, unchecked
from motiongen_server.identity.key_set import Key
from motiongen_server.identity.keys import KeyRings, KeysUnavailable
from motiongen_server.identity.tenants import Tenant, Tenants
from motiongen_server.identity.tokens import UNKNOWN, number_of
from motiongen_server.identity.watched import Watched

AUTHORIZATION = "authorization"
NO_QUOTAS: Mapping[str, Mapping[str, float]] = {}
_SCHEME = "bearer "
_NAMES = ("x509_common_name", "x509_subject_alternative_name")

Metadata = Iterable[tuple[str, str | bytes]]
AuthContext = Mapping[str, Iterable[bytes]]


class Callers:
    """Without tenants, everybody who gets through TLS may call. If a call has a token, its certificate is ignored.

    tenants: the watched file of tenants. wall: returns seconds since 1970. rings: the keys of token issuers.
    """

    def __init__(
        self,
        tenants: Watched[Tenants] | None = None,
        wall: Callable[[], float] = time.time,
        rings: KeyRings | None = None,
    ) -> None:
        self._tenants = tenants
        self._wall = wall
        self._rings = rings or KeyRings()
        self._checks = TokenChecks()

    def identify(self, metadata: Metadata, connection: AuthContext, role: Role = Role.MOTION) -> Caller:
        """The caller. connection: gRPC's auth context. Raises StreamRefused for bad credentials or a missing role."""
        num_shown = sum(key.lower() == AUTHORIZATION for key, _ in metadata)
        if num_shown > 1 and self._tenants is not None:  # a proxy in front may have checked another one of them
            raise credentials_repeated(num_shown)
        return self.of_header(_authorization(metadata), role, certificate_names(connection))

    def wanted(self, metadata: Metadata) -> Future[None] | None:
        """A fetch of the issuer's keys that should finish before `identify` is called; None: there is none."""
        signed = self._signed(_token(_authorization(metadata)))
        return None if signed is None else self._rings.of(signed[1].source).wanted(signed[0].key_id)

    def num_unchecked(self, metadata: Metadata) -> int:
        """Characters of the token if `identify` would have to parse and check it, else 0.

        Does not parse the token itself.
        """
        token = _token(_authorization(metadata))
        if self._tenants is None or not self._tenants.value.issuers or not may_be_signed(token):
            return 0
        said = self._checks.said(token)
        issuer = None if said is None else self._tenants.value.issuers.get(said.issuer)
        if said is None or issuer is None:
            return len(token)
        return 0 if self._checks.known(said, issuer, self._rings.of(issuer.source)) is not None else len(token)

    def _signed(self, token: str) -> tuple[Unchecked, Issuer] | None:
        """What a token says, and its issuer; None if it is not a signed token or its issuer is unknown."""
        if self._tenants is None or not self._tenants.value.issuers:
            return None
        said = self._said(token)
        issuer = None if said is None else self._tenants.value.issuers.get(said.issuer)
        return None if said is None or issuer is None else (said, issuer)

    def _said(self, token: str) -> Unchecked | None:
        return self._checks.said(token) or unchecked(token)

    def of_header(self, authorization: str, role: Role, certificates: Sequence[str] = ()) -> Caller:
        """Like `identify`. authorization: the value of that header. certificates: names of the client's certificate."""
        if self._tenants is None:
            return Caller(credential=f"certificate {certificates[0]!r}") if certificates else ANYBODY
        self.look()
        caller = self._find(authorization, certificates, self._tenants.value)
        if role not in caller.roles:
            raise role_missing(role)
        return caller

    def metrics_refusal(self, ops_host: str, authorization: str) -> str | None:
        """Why the sender of an `authorization` header may not read the metrics, in words; None if it may.

        ops_host: where they are served; if only programs on this machine can reach it, all of them may read them.
        """
        if is_local(ops_host):
            return None
        self.wanted(((AUTHORIZATION, authorization),))  # starts fetching a new key, for the next scrape
        try:
            self.of_header(authorization, Role.METRICS)
        except StreamRefused as refusal:
            return str(refusal)
        return None

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
        token = _token(authorization)
        said = self._said(token) if tenants.issuers else None
        if said is not None:
            return self._of_signed(said, tenants)
        number = number_of(token)
        tenant, known = tenants.by_token.get(number or "", (None, None))
        is_right = (known.hash if known is not None else UNKNOWN).is_of(token)
        if tenant is None or known is None or not is_right:
            raise credentials_invalid()
        if known.expires_at is not None and known.expires_at <= self._wall():
            raise credentials_expired()
        return _caller(tenant, f"token {number}", known.expires_at)

    def _of_signed(self, said: Unchecked, tenants: Tenants) -> Caller:
        issuer = tenants.issuers.get(said.issuer)
        if issuer is None:
            raise credentials_invalid()
        good = self._checks.check(said, issuer, self._rings.of(issuer.source))
        if good.expires_at <= self._wall():
            raise credentials_expired()
        tenant = tenants.by_name.get(good.tenant)
        if tenant is None or issuer.name not in tenant.issuers:
            raise tenant_unknown(good.tenant)
        caller = _caller(tenant, f"token of {issuer.name}", good.expires_at)
        return replace(caller, signed_by=(issuer.issuer, good.key))

    # ---- afterwards -------------------------------------------------------------------------------------------------

    def look(self) -> None:
        """Reload the tenants' file if it has changed, and the keys of issuers that have changed or must be fetched."""
        if self._tenants is not None:
            self._tenants.look()
            for issuer in self._tenants.value.issuers.values():
                self._rings.of(issuer.source).look()

    @property
    def quotas(self) -> Mapping[str, Mapping[str, float]]:
        """By tenant, as of the last `look`; the same object until the file is read again."""
        return NO_QUOTAS if self._tenants is None else self._tenants.value.quotas

    def lapse(self, caller: Caller, role: Role = Role.MOTION) -> StreamRefused | None:
        """Why a caller may not continue what requires `role`, as of the last `look`; None if it may."""
        remaining_s = self.remaining_s(caller)
        if remaining_s is not None and remaining_s <= 0:
            return credentials_expired()
        if self._tenants is None or not caller.tenant:
            return None
        tenant = self._tenants.value.by_name.get(caller.tenant)
        if tenant is None or role not in tenant.roles:
            return credentials_revoked()
        if caller.signed_by is not None:
            return None if self._still_signs(tenant, *caller.signed_by) else credentials_revoked()
        kind, _, name = caller.credential.partition(" ")
        there = (
            [f"{token.hash.number}" for token in tenant.tokens] if kind == "token" else map(repr, tenant.certificates)
        )
        return None if name in there else credentials_revoked()

    def _still_signs(self, tenant: Tenant, issuer: str, key: Key) -> bool:
        assert self._tenants is not None
        known = self._tenants.value.issuers.get(issuer)
        if known is None or known.name not in tenant.issuers:
            return False
        try:
            return self._rings.of(known.source).tells(key)
        except KeysUnavailable:  # a caller that was admitted before may continue until its token expires
            return True

    def remaining_s(self, caller: Caller) -> float | None:
        """Seconds until the caller's credentials expire; None: never. A token's expiry is that of the current file."""
        expires_at = caller.expires_at
        kind, _, name = caller.credential.partition(" ")
        if self._tenants is not None and kind == "token" and caller.signed_by is None:
            _, token = self._tenants.value.by_token.get(name, (None, None))
            expires_at = expires_at if token is None else token.expires_at
        return None if expires_at is None else expires_at - self._wall()


def _authorization(metadata: Metadata) -> str:
    return str(next((text for key, text in metadata if key.lower() == AUTHORIZATION), ""))


def _token(authorization: str) -> str:
    return authorization[len(_SCHEME) :].strip() if authorization.lower().startswith(_SCHEME) else ""


def certificate_names(connection: AuthContext) -> list[str]:
    """The names in the client's certificate, which gRPC has verified; empty if it presented none."""
    return [name.decode(errors="replace") for key in _NAMES for name in connection.get(key, ())]


def _caller(tenant: Tenant, credential: str, expires_at: float | None) -> Caller:
    return Caller(tenant.name, credential, tenant.roles, expires_at, tenant.quota)
