"""Tokens for a server under attack: a lasting one for good clients, an expiring one for hostile clients."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

from motiongen_server.identity.tokens import new_token

TOKEN_VARIABLE = "HOSTILE_TOKEN"
Metadata = tuple[tuple[str, str], ...]


def bearer(token: str) -> Metadata:
    """The metadata of a call with this token; nothing without a token."""
    return (("authorization", f"Bearer {token}"),) if token else ()


class Tokens:
    """A file of tenants, in a folder. good: the good clients' token. hostile: the other, once there is one."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tenants.toml"
        self.good, self._kept = new_token()
        self.hostile = ""
        self._write("")

    @property
    def settings(self) -> tuple[str, ...]:
        """The server's settings."""
        return ("--tenants", str(self.path))

    def let_in_for(self, seconds: float) -> None:
        """Give hostile clients a token that is valid for so long."""
        self.hostile, kept = new_token()
        expires = (datetime.now(UTC) + timedelta(seconds=seconds)).isoformat().replace("+00:00", "Z")
        self._write(f'[tenants.hostile]\ntokens = [{{ hash = "{kept}", expires = {expires} }}]\n')

    def _write(self, more: str) -> None:
        self.path.write_text(f'[tenants.good]\ntokens = [{{ hash = "{self._kept}" }}]\n{more}', encoding="utf-8")
