"""The tests' certificates, and files of tenants."""

from __future__ import annotations

import shutil
from pathlib import Path

import grpc

from motiongen_server.identity.callers import Callers
from motiongen_server.identity.tenants import read_tenants
from motiongen_server.identity.tokens import new_token
from motiongen_server.identity.watched import Watched

CERTIFICATES = Path(__file__).parents[2] / "certificates"
AUTHORITY = str(CERTIFICATES / "authority.pem")


def copy_pair(name: str, folder: Path) -> tuple[str, str]:
    """Copy a certificate and its key to where a server reads them. Returns their paths, the same ones each time."""
    certificate, key = folder / "server.pem", folder / "server.key"
    shutil.copyfile(CERTIFICATES / f"{name}.pem", certificate)
    shutil.copyfile(CERTIFICATES / f"{name}.key", key)
    return str(certificate), str(key)


def client_credentials(name: str = "") -> grpc.ChannelCredentials:
    """Credentials that trust the tests' authority and present the certificate of that name."""
    authority = Path(AUTHORITY).read_bytes()
    if not name:
        return grpc.ssl_channel_credentials(authority)
    key, certificate = (CERTIFICATES / f"{name}{ending}" for ending in (".key", ".pem"))
    return grpc.ssl_channel_credentials(authority, key.read_bytes(), certificate.read_bytes())


def bearer(token: str) -> tuple[tuple[str, str], ...]:
    return (("authorization", f"Bearer {token}"),)


class TenantsFile:
    """The file of tenants that a test writes. wall: the wall-clock time that its `callers` read."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "tenants.toml"
        self.wall = 1_800_000_000.0
        self._writes = 0

    def write(self, text: str) -> None:
        self._writes += 1
        # A comment of a different length each time, so that coarse timestamps of the file system hide no change.
        self.path.write_text(text + f"\n#{'.' * self._writes}\n")

    def one(self, more: str = "", expires: str = "", name: str = "studio") -> str:
        """Write a file with one tenant. Returns its token."""
        token, kept = new_token()
        until = f", expires = {expires}" if expires else ""
        self.write(f'[tenants.{name}]\ntokens = [{{ hash = "{kept}"{until} }}]\n{more}')
        return token

    def callers(self) -> Callers:
        path = str(self.path)
        return Callers(Watched("tenants", [path], lambda: read_tenants(path)), lambda: self.wall)
