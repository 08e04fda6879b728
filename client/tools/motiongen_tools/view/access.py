"""Access control of the bridge: tokens for watching and steering, and protection against pages of other sites."""

from __future__ import annotations

import enum
import hmac
import secrets
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import SplitResult, urlsplit

_OUR_SITES = ("same-origin", "none")
"""Allowed values of Sec-Fetch-Site: our page makes the request, or the user, who typed the address."""


class Role(enum.Enum):
    """What a browser may do: steer, or only watch."""

    CONTROL = "control"
    WATCH = "watch"


@dataclass(frozen=True)
class Access:
    """The rules of one bridge. control_token, watch_token: None if no token is required, which only loopback allows."""

    control_token: str | None = field(default=None, repr=False)
    watch_token: str | None = field(default=None, repr=False)

    @classmethod
    def to_listen_at(cls, host: str, wants_token: bool = False) -> Access:
        """No tokens on loopback; new tokens on any other address, or if they are wanted."""
        if is_loopback(host) and not wants_token:
            return cls()
        return cls(secrets.token_urlsafe(16), secrets.token_urlsafe(16))

    def role_of(self, token: str) -> Role | None:
        """The role that a token gives; None if it gives none."""
        if self.control_token is None or self.watch_token is None:
            return Role.CONTROL
        given = token.encode()
        if hmac.compare_digest(given, self.control_token.encode()):
            return Role.CONTROL
        return Role.WATCH if hmac.compare_digest(given, self.watch_token.encode()) else None

    def admits_host(self, host: str) -> bool:
        """Whether a request may name this host. Without tokens only loopback is allowed, so that a name which somebody
        else points at this machine does not reach the bridge.
        """
        return self.control_token is not None or is_loopback(_split(f"//{host}").hostname or "")


def is_own_page(origin: str | None, host: str, fetch_site: str | None = None) -> bool:
    """Whether our page makes the request, or a program, which sends neither origin nor fetch_site.

    A browser lets any site open WebSockets here, and send posts that need no permission; only reading is prevented.
    What it requests for another site as a picture or through a link has no origin: there, Sec-Fetch-Site tells.
    """
    if fetch_site not in (None, *_OUR_SITES):
        return False
    if origin is None:
        return True
    site = _split(origin).netloc.lower()
    return site != "" and site == host.lower()


def _split(address: str) -> SplitResult:
    """The parts of an address; empty ones if it is not valid."""
    try:
        return urlsplit(address)
    except ValueError:
        return SplitResult("", "", "", "", "")


def is_loopback(host: str) -> bool:
    """Whether an address can only be reached from this machine."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
