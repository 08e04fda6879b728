"""Tenants: the file that says who may call, with which credentials, and how much each may have.

[tenants.studio]
roles = ["motion"]                       # the default; also "admin", "metrics"
certificates = ["studio.example"]        # names of client certificates, common or alternative
issuers = ["corp"]                       # whose signed tokens may name this tenant: names of entries of `issuers`
tokens = [{ hash = "sha256:...", expires = 2027-01-01T00:00:00Z }]
quota = { heroes = 8, session_weight = 64 }
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from motiongen_server.identity.caller import DEFAULT_ROLES, Role
from motiongen_server.identity.entries import mapping, number, table, words
from motiongen_server.identity.issuers import Issuer, read_issuer
from motiongen_server.identity.tokens import TokenHash

QUOTAS = {
    "streams": (1, 100_000),
    "calls": (1, 100_000),
    "events_per_second": (1, 1e9),
    "prompts_per_second": (0.1, 1e6),
    "calls_per_second": (0.1, 1e6),
    "bytes_per_second": (1024, 1e12),
    "session_weight": (1, 1_000_000),
    "heroes": (0, 1_000_000),
    "nears": (0, 1_000_000),
    "crowds": (0, 1_000_000),
    "batches": (0, 1_000_000),
    "clip_samples": (0, 100_000),
    "share": (0.01, 1000),
    "steps_per_second": (1, 1e9),
}
"""Limits that a tenant may have instead of those of an address, and their ranges; names as in `rpc.limits.PeerLimits`.
"""


@dataclass(frozen=True)
class Token:
    """expires_at: seconds of the wall clock since 1970; None: never."""

    hash: TokenHash
    expires_at: float | None


@dataclass(frozen=True)
class Tenant:
    """One entry of the file."""

    name: str
    roles: frozenset[Role] = DEFAULT_ROLES
    tokens: tuple[Token, ...] = ()
    certificates: tuple[str, ...] = ()
    issuers: tuple[str, ...] = ()
    quota: Mapping[str, float] = field(default_factory=dict)


class Tenants:
    """All tenants, by name and by credential. issuers: by the claim `iss`."""

    def __init__(self, tenants: Iterable[Tenant], issuers: Iterable[Issuer] = ()) -> None:
        """Raises ValueError if a credential or an issuer occurs twice, or a tenant names an unknown issuer."""
        self.issuers: dict[str, Issuer] = {}
        for issuer in issuers:
            self._check_new(issuer.issuer in self.issuers, "issuer", issuer.issuer)
            self.issuers[issuer.issuer] = issuer
        names = [issuer.name for issuer in self.issuers.values()]
        self.by_name = {tenant.name: tenant for tenant in tenants}
        self.quotas = {tenant.name: tenant.quota for tenant in self.by_name.values()}
        self.by_token: dict[str, tuple[Tenant, Token]] = {}
        self.by_certificate: dict[str, Tenant] = {}
        for tenant in self.by_name.values():
            for token in tenant.tokens:
                self._check_new(token.hash.number in self.by_token, "token", token.hash.number)
                self.by_token[token.hash.number] = (tenant, token)
            for name in tenant.issuers:
                if name not in names:
                    raise ValueError(f"{tenant.name}.issuers has {name}; known are {', '.join(names) or 'none'}")
            for name in tenant.certificates:
                self._check_new(name in self.by_certificate, "certificate", name)
                self.by_certificate[name] = tenant

    @staticmethod
    def _check_new(is_there: bool, kind: str, name: str) -> None:
        if is_there:
            raise ValueError(f"the {kind} {name!r} is given twice; give each only once, to one tenant")


def read_tenants(path: str) -> Tenants:
    """Raises ValueError if the file is invalid, OSError if it cannot be read."""
    try:
        text = Path(path).read_text(encoding="utf-8-sig")  # some editors write a byte order mark
        if not text.strip():  # as for a moment while it is rewritten; nobody must be thrown out then
            raise ValueError("it is empty; write [tenants] alone to let nobody in")
        document = tomllib.loads(text)
        parts = table(document, {"tenants", "issuers"}, "the file")
        issuers = mapping(parts.get("issuers", {}), "issuers")
        tenants = mapping(parts.get("tenants", {}), "tenants")
        return Tenants(
            [_tenant(name, mapping(entry, name)) for name, entry in tenants.items()],
            [read_issuer(name, mapping(entry, f"issuers.{name}")) for name, entry in issuers.items()],
        )
    except ValueError as error:  # errors of TOML and of the encoding are ValueErrors too
        raise ValueError(f"{path}: {error}") from error


def _tenant(name: str, entry: Mapping[str, Any]) -> Tenant:
    if not name:
        raise ValueError(
            "tenants has an entry without a name; give it one, which tells its sessions from those of others"
        )
    entry = table(entry, {"roles", "tokens", "certificates", "issuers", "quota"}, name)
    roles = words(entry.get("roles", [role.value for role in DEFAULT_ROLES]), f"{name}.roles")
    unknown = sorted(set(roles) - {role.value for role in Role})
    if unknown:
        raise ValueError(f"{name}.roles has {', '.join(unknown)}; known are {', '.join(role.value for role in Role)}")
    tokens = entry.get("tokens", [])
    if not isinstance(tokens, list):
        raise ValueError(f"{name}.tokens must be a list of tables with hash and, if it expires, expires")
    return Tenant(
        name,
        frozenset(map(Role, roles)),
        tuple(_token(mapping(token, f"{name}.tokens"), f"{name}.tokens") for token in tokens),
        words(entry.get("certificates", []), f"{name}.certificates"),
        words(entry.get("issuers", []), f"{name}.issuers"),
        _quota(mapping(entry.get("quota", {}), f"{name}.quota"), name),
    )


def _token(entry: Mapping[str, Any], where: str) -> Token:
    entry = table(entry, {"hash", "expires"}, where)
    expires = entry.get("expires")
    if expires is not None and (not isinstance(expires, datetime) or expires.tzinfo is None):
        raise ValueError(f"{where} has expires = {expires}; give date, time and zone, such as 2027-01-01T00:00:00Z")
    try:
        return Token(TokenHash.parse(str(entry.get("hash"))), None if expires is None else expires.timestamp())
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _quota(entry: Mapping[str, Any], name: str) -> dict[str, float]:
    entry = table(entry, set(QUOTAS), f"{name}.quota")
    for key, value in entry.items():
        number(value, *QUOTAS[key], f"{name}.quota.{key}")
    return dict(entry)
