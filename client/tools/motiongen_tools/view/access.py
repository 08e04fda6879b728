"""Who may look and who may steer: tokens, and pages of other sites kept out."""

from __future__ import annotations

import enum
import hmac
import secrets
from dataclasses import dataclass, field
from ipaddress import ip_address
from urllib.parse import urlsplit


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
        return self.control_token is not None or is_loopback(urlsplit(f"//{host}").hostname or "")


def is_own_page(origin: str | None, host: str) -> bool:
    """Whether something was asked by our page, or by a program, which sends no origin.

    A browser lets any site open WebSockets here, and post what needs no leave of ours; only reading is kept from it.
    """
    return origin is None or urlsplit(origin).netloc.lower() == host.lower()


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address."""
    if host == "localhost":
        return True
    try:
        return ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False
