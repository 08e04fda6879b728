"""Sets up identity from the settings: TLS for the ports, the callers, and listening on an address."""

from __future__ import annotations

import logging
import ssl

import grpc
import grpc.aio

from motiongen_server.addresses import UNIX, is_local
from motiongen_server.identity.callers import Callers
from motiongen_server.identity.keys import KeyRings
from motiongen_server.identity.tenants import Tenants, read_tenants
from motiongen_server.identity.tls import ServerTls, TlsFiles, server_context
from motiongen_server.identity.watched import Watched
from motiongen_server.protection import Protection, lacks, ops_lacks
from motiongen_server.settings import SettingError

_log = logging.getLogger(__name__)


def make_tls(config: Protection) -> ServerTls | None:
    """TLS for the gRPC port; None: plain text. Raises SettingError."""
    if not config.tls_certificate:
        return None
    return ServerTls(TlsFiles(config.tls_certificate, config.tls_key, config.tls_client_ca))


def make_ops_context(config: Protection) -> ssl.SSLContext | None:
    """TLS for the port of health and metrics; None: plain text. Raises SettingError."""
    return server_context(TlsFiles(config.tls_certificate, config.tls_key)) if config.ops_tls else None


def make_callers(config: Protection) -> Callers:
    """The callers of the settings' tenants. Raises SettingError."""
    if not config.tenants:
        return Callers()
    rings = KeyRings()

    def read() -> Tenants:
        tenants = read_tenants(config.tenants)
        for issuer in tenants.issuers.values():
            rings.of(issuer.source)  # raises if a file that it names is missing
        return tenants

    try:
        callers = Callers(Watched("tenants", [config.tenants], read), rings=rings)
        callers.look()  # begins to fetch the keys of issuers
        return callers
    except (ValueError, OSError) as error:
        raise SettingError(f"tenants cannot be read: {error}") from error


def warn_of_exposure(config: Protection) -> None:
    """Log which ports other machines can reach without protection, as `insecure` allows."""
    for name, host, lacking in (("gRPC", config.host, lacks(config)), ("ops", config.ops_host, ops_lacks(config))):
        if lacking and not is_local(host):
            _log.warning("%s is served to other machines on %s without %s", name, host, " and without ".join(lacking))
    if config.tenants and not config.ops_tls and not is_local(config.ops_host):
        _log.warning("tokens for the metrics cross the network to %s in plain text; --ops-tls encrypts them",
                     config.ops_host)  # fmt: skip


def listen(server: grpc.aio.Server, address: str, what: str, tls: ServerTls | None = None) -> int:
    """Make a gRPC server listen on an address; returns the port, 0 for a unix socket. Raises SettingError.

    what: is appended to the address in the error message.
    """
    credentials = None if tls is None else tls.credentials()
    try:
        if credentials is None:
            port = server.add_insecure_port(address)
        else:
            port = server.add_secure_port(address, credentials)
    except RuntimeError as error:
        raise SettingError(f"cannot listen on {address}{what}; choose another port, or 0") from error
    return 0 if address.startswith(UNIX) else port
