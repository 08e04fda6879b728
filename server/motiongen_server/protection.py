"""What protects a program's ports: the settings of TLS and callers that the gateway and the encoder service share."""

from __future__ import annotations

from typing import Protocol

from motiongen_server.addresses import UNIX, check_exposure
from motiongen_server.settings import SettingError


class Protection(Protocol):
    """Settings of either program, by their names."""

    @property
    def host(self) -> str: ...

    @property
    def ops_host(self) -> str: ...

    @property
    def ops_tls(self) -> bool: ...

    @property
    def tls_certificate(self) -> str: ...

    @property
    def tls_key(self) -> str: ...

    @property
    def tls_client_ca(self) -> str: ...

    @property
    def tenants(self) -> str: ...

    @property
    def insecure(self) -> bool: ...


def check_protection(config: Protection) -> None:
    """Raise SettingError for settings that do not fit together, and for a port that others reach unprotected."""
    if bool(config.tls_certificate) != bool(config.tls_key):
        raise SettingError("tls_certificate and tls_key must be given together")
    if config.tls_client_ca and not config.tls_certificate:
        raise SettingError("tls_client_ca is given, and no tls_certificate; clients show theirs within TLS only")
    if config.ops_tls and not config.tls_certificate:
        raise SettingError("ops_tls is given, and no tls_certificate; the port of operations shows that of gRPC")
    if config.host == UNIX:
        raise SettingError(f"host is {config.host!r}; give the path of a socket with it, such as unix:/run/motion.sock")
    if config.ops_host.startswith(UNIX):
        raise SettingError(
            f"ops_host is {config.ops_host!r}; it must be an address or a name: HTTP is not served on unix sockets"
        )
    check_exposure("host", config.host, lacks(config), config.insecure)
    check_exposure("ops_host", config.ops_host, ops_lacks(config), config.insecure)


def lacks(config: Protection) -> tuple[str, ...]:
    """What would protect the gRPC port and is not there, in words."""
    asks = config.tenants or config.tls_client_ca
    tls = () if config.tls_certificate else ("TLS (--tls-certificate, --tls-key)",)
    return tls if asks else (*tls, "asking who calls (--tenants or --tls-client-ca)")


def ops_lacks(config: Protection) -> tuple[str, ...]:
    """The same of the port of health checks and metrics."""
    return () if config.tenants else ("asking who reads the metrics (--tenants)",)
