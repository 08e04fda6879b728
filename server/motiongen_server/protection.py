"""The settings that protect a program's ports, for TLS and callers; the gateway and the encoder service share them."""

from __future__ import annotations

from typing import Protocol

from motiongen_server.addresses import UNIX, check_exposure
from motiongen_server.settings import SettingError


class Protection(Protocol):
    """These settings, of either program."""

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
    """Raise SettingError if these settings contradict each other, or other machines can reach an unprotected port."""
    if bool(config.tls_certificate) != bool(config.tls_key):
        raise SettingError("tls_certificate and tls_key must be given together")
    if config.tls_client_ca and not config.tls_certificate:
        raise SettingError("tls_client_ca is given without tls_certificate; clients present certificates only over TLS")
    if config.ops_tls and not config.tls_certificate:
        raise SettingError("ops_tls is given without tls_certificate; the ops port uses the gRPC port's certificate")
    if config.host == UNIX:
        raise SettingError(f"host is {config.host!r}; give the path of a socket with it, such as unix:/run/motion.sock")
    if config.ops_host.startswith(UNIX):
        raise SettingError(
            f"ops_host is {config.ops_host!r}; it must be an address or a name: HTTP is not served on unix sockets"
        )
    check_exposure("host", config.host, lacks(config), config.insecure)
    check_exposure("ops_host", config.ops_host, ops_lacks(config), config.insecure)


def lacks(config: Protection) -> tuple[str, ...]:
    """The protection that the gRPC port lacks, in words."""
    asks = config.tenants or config.tls_client_ca
    tls = () if config.tls_certificate else ("TLS (--tls-certificate, --tls-key)",)
    return tls if asks else (*tls, "authentication of callers (--tenants or --tls-client-ca)")


def ops_lacks(config: Protection) -> tuple[str, ...]:
    """The protection that the port of health checks and metrics lacks, in words."""
    return () if config.tenants else ("authentication for the metrics (--tenants)",)
