"""Issuers, as the tenants' file lists them: who may sign tenants' tokens (JSON Web Tokens, RFC 7519).

[issuers.corp]
issuer = "https://login.example"                 # must equal the claim iss exactly
audience = ["motiongen"]                         # one of these must be in the claim aud
keys = "https://login.example/jwks.json"         # or a file; left out: found by OpenID Connect discovery
authority = "login-ca.pem"                       # CA of the certificate there; left out: those of the system
algorithms = ["RS256", "ES256"]
tenant_claim = "tenant"                          # the claim with the tenant's name
leeway_s = 30                                    # how far clocks may differ
refresh_s = 300                                  # keys are fetched again after this time
stale_s = 3600                                   # how long keys stay valid after that if no newer ones can be fetched
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from motiongen_server.addresses import is_local
from motiongen_server.identity.entries import number, table, word, words

ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""Those with a public key only: whoever can check a token must not be able to make one. `none` is not among them."""
DEFAULT_ALGORITHMS = ("RS256", "ES256", "EdDSA")
DISCOVERY = "/.well-known/openid-configuration"
_KNOWN = {
    "issuer", "audience", "keys", "authority", "algorithms", "tenant_claim", "leeway_s", "refresh_s", "stale_s",
}  # fmt: skip


@dataclass(frozen=True)
class KeySource:
    """Where an issuer's keys are. place: a file or a URL. is_discovery: the document at the URL names the keys' URL.

    authority: PEM file of the certificate authority for that host; "": those of the system.
    """

    place: str
    is_discovery: bool = False
    authority: str = ""
    refresh_s: float = 300.0
    stale_s: float = 3600.0

    @property
    def is_url(self) -> bool:
        return "://" in self.place


@dataclass(frozen=True)
class Issuer:
    """One entry of the file. issuer: the claim `iss` of its tokens."""

    name: str
    issuer: str
    audience: tuple[str, ...]
    source: KeySource
    algorithms: tuple[str, ...] = DEFAULT_ALGORITHMS
    tenant_claim: str = "tenant"
    leeway_s: float = 30.0


def read_issuer(name: str, entry: Mapping[str, Any]) -> Issuer:
    """Raises ValueError if the entry is invalid."""
    entry = table(entry, _KNOWN, f"issuers.{name}")
    where = f"issuers.{name}"
    issuer = word(entry.get("issuer"), f"{where}.issuer")
    audience = words(entry.get("audience", []), f"{where}.audience")
    if not audience:
        raise ValueError(f"{where}.audience is empty; give the claim aud of tokens for this server")
    algorithms = words(entry.get("algorithms", list(DEFAULT_ALGORITHMS)), f"{where}.algorithms")
    unknown = sorted(set(algorithms) - set(ALGORITHMS))
    if unknown or not algorithms:
        raise ValueError(f"{where}.algorithms has {', '.join(unknown) or 'none'}; known are {', '.join(ALGORITHMS)}")
    return Issuer(
        name,
        issuer,
        audience,
        _source(entry, issuer, where),
        algorithms,
        word(entry.get("tenant_claim", "tenant"), f"{where}.tenant_claim"),
        number(entry.get("leeway_s", 30.0), 0, 300, f"{where}.leeway_s"),
    )


def _source(entry: Mapping[str, Any], issuer: str, where: str) -> KeySource:
    place, is_discovery = entry.get("keys"), False
    if place is None:
        place, is_discovery = issuer.rstrip("/") + DISCOVERY, True
    source = KeySource(
        word(place, f"{where}.keys"),
        is_discovery,
        word(entry["authority"], f"{where}.authority") if "authority" in entry else "",
        number(entry.get("refresh_s", 300.0), 1, 86_400, f"{where}.refresh_s"),
        number(entry.get("stale_s", 3600.0), 0, 604_800, f"{where}.stale_s"),
    )
    if source.is_url:
        check_url(source.place, f"{where}.{'issuer' if is_discovery else 'keys'}")
    elif is_discovery:
        raise ValueError(f"{where} has no keys, and its issuer is not a URL to find them by; give keys, a file or URL")
    return source


def check_url(url: str, where: str) -> None:
    """Raise ValueError for a URL with a password in it, and for one whose answer could be changed in transit."""
    parts = urlsplit(url)
    if parts.username is not None:
        raise ValueError(f"{where} has a name or a password in its URL, which would not be sent; leave it out")
    if parts.scheme == "https" and parts.hostname:
        return
    if parts.scheme != "http" or not is_local(parts.hostname or "?"):
        raise ValueError(f"{where} is {url!r}; keys are fetched only by https, or by http from this machine")
