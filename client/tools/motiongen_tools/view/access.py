"""Who may look and who may steer: tokens, and pages of other sites kept out."""

from __future__ import annotations

import enum
import hmac
import secrets
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import SplitResult, urlsplit

_OUR_SITES = ("same-origin", "none")
"""Values of Sec-Fetch-Site: our page asks, or the user does, who has typed the address."""


class Role(enum.Enum):
    """What a browser may do: steer, or only look on."""

    CONTROL = "control"
    WATCH = "watch"


@dataclass(frozen=True)
class Access:
    """The rules of one bridge. control_token, watch_token: None where nobody is asked, which only loopback allows."""

    control_token: str | None = field(default=None, repr=False)
    watch_token: str | None = field(default=None, repr=False)

    @classmethod
    def to_listen_at(cls, host: str, wants_token: bool = False) -> Access:
        """Open on loopback; with fresh tokens on any other address, or where they are wanted."""
        if is_loopback(host) and not wants_token:
            return cls()
        return cls(secrets.token_urlsafe(16), secrets.token_urlsafe(16))

    def role_of(self, token: str) -> Role | None:
        """What the bearer of a token may do; None: nothing."""
        if self.control_token is None or self.watch_token is None:
            return Role.CONTROL
        given = token.encode()
        if hmac.compare_digest(given, self.control_token.encode()):
            return Role.CONTROL
        return Role.WATCH if hmac.compare_digest(given, self.watch_token.encode()) else None

    def admits_host(self, host: str) -> bool:
        """Whether a request may name this host: without tokens only loopback, so that no name that somebody else
        points at this machine reaches the bridge."""
        return self.control_token is not None or is_loopback(_split(f"//{host}").hostname or "")


def is_own_page(origin: str | None, host: str, fetch_site: str | None = None) -> bool:
    """Whether something was asked by our page, or by a program, which sends neither origin nor fetch_site.

    A browser lets any site open WebSockets here, and post what needs no leave of ours; only reading is kept from it.
    What it gets for another site, as a picture say or by a link, has no origin: there its Sec-Fetch-Site tells.
    """
    if fetch_site not in (None, *_OUR_SITES):
        return False
    if origin is None:
        return True
    site = _split(origin).netloc.lower()
    return site != "" and site == host.lower()


def _split(address: str) -> SplitResult:
    """The parts of an address; of what is none, empty ones."""
    try:
        return urlsplit(address)
    except ValueError:
        return SplitResult("", "", "", "", "")


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
