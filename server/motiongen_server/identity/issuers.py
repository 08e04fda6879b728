"""Issuers: who may sign the tokens of tenants (JSON Web Tokens, RFC 7519), as the tenants' file says.

[issuers.corp]
issuer = "https://login.example"                 # the claim iss, to the letter
audience = ["motiongen"]                         # one of these must be in the claim aud
keys = "https://login.example/jwks.json"         # or a file; left out: as OpenID Connect finds them from the issuer
authority = "login-ca.pem"                       # who signed the certificate there; left out: those of the system
algorithms = ["RS256", "ES256"]
tenant_claim = "tenant"                          # whose value is the tenant's name
leeway_s = 30                                    # what clocks may differ by
refresh_s = 300                                  # after which keys are fetched again
stale_s = 3600                                   # for which those that were fetched hold while no others come
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from motiongen_server.addresses import is_local
from motiongen_server.identity.entries import number, table, word, words

ALGORITHMS = ("RS256", "RS384", "RS512", "PS256", "PS384", "PS512", "ES256", "ES384", "ES512", "EdDSA")
"""With a public key: who checks a token must not be able to make one. `none` is no algorithm."""
DEFAULT_ALGORITHMS = ("RS256", "ES256", "EdDSA")
DISCOVERY = "/.well-known/openid-configuration"
_KNOWN = {
    "issuer", "audience", "keys", "authority", "algorithms", "tenant_claim", "leeway_s", "refresh_s", "stale_s",
}  # fmt: skip


@dataclass(frozen=True)
class KeySource:
    """Where an issuer's keys are. place: a file, or a URL. is_discovery: the URL is of what names the keys' own.

    authority: PEM file of who signed the certificate there, "": the system's.
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
    """One entry of the file. issuer: what its tokens say in `iss`."""

    name: str
    issuer: str
    audience: tuple[str, ...]
    source: KeySource
    algorithms: tuple[str, ...] = DEFAULT_ALGORITHMS
    tenant_claim: str = "tenant"
    leeway_s: float = 30.0


def read_issuer(name: str, entry: Mapping[str, Any]) -> Issuer:
    """Raises ValueError for what is wrong in an entry."""
    entry = table(entry, _KNOWN, f"issuers.{name}")
    where = f"issuers.{name}"
    issuer = word(entry.get("issuer"), f"{where}.issuer")
    audience = words(entry.get("audience", []), f"{where}.audience")
    if not audience:
        raise ValueError(f"{where}.audience is empty; name what tokens for this server say in aud")
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
        raise ValueError(f"{where} has no keys, and its issuer is no URL to find them by; give keys, a file or a URL")
    return source


def check_url(url: str, where: str) -> None:
    """Raise ValueError for a URL whose answer others could change on its way, and for one with a password in it."""
    parts = urlsplit(url)
    if parts.username is not None:
        raise ValueError(f"{where} has a name or a password in its URL, which would not be shown; leave it out")
    if parts.scheme == "https" and parts.hostname:
        return
    if parts.scheme != "http" or not is_local(parts.hostname or "?"):
        raise ValueError(f"{where} is {url!r}; keys come by https, or by http from this machine alone")
