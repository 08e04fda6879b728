"""TLS: the server's certificate, the authorities for clients' certificates, and how both are renewed."""

from __future__ import annotations

import ssl
import time
from dataclasses import dataclass
from pathlib import Path

import grpc

from motiongen_server.identity.watched import Watched
from motiongen_server.settings import SettingError

REST_S = 0.1


@dataclass(frozen=True)
class TlsFiles:
    """PEM files. certificate: the server's, with its chain. key: its private key, not encrypted.

    client_ca: the authorities, one of which must have signed a client's certificate; "": clients need no certificate.
    """

    certificate: str
    key: str
    client_ca: str = ""

    @property
    def paths(self) -> tuple[str, ...]:
        """The files that are given."""
        return tuple(path for path in (self.certificate, self.key, self.client_ca) if path)

    def read(self) -> grpc.ServerCertificateConfiguration:
        """Their content, for gRPC. Raises ValueError if they do not belong together, OSError if one cannot be read."""
        check_pair(self.certificate, self.key)
        authorities = None
        if self.client_ca:
            check_authorities(self.client_ca)
            authorities = Path(self.client_ca).read_bytes()
        pair = (Path(self.key).read_bytes(), Path(self.certificate).read_bytes())
        return grpc.ssl_server_certificate_configuration([pair], root_certificates=authorities)


class Renewal:
    """gRPC calls it whenever a client connects, one thread at a time: returns new certificates, or None for the same.

    When gRPC gets new certificates, it frees the old ones at once, though another thread may be about to use them: a
    handshake that begins at that moment crashes the process. Hence it gets them only if they have changed, and after
    `REST_S`: no handshake can begin in that time, and those that have begun hold references to what they use.
    """

    def __init__(self, watched: Watched[grpc.ServerCertificateConfiguration]) -> None:
        self._watched = watched
        self.given = watched.value

    def __call__(self) -> grpc.ServerCertificateConfiguration | None:
        self._watched.look()
        value = self._watched.value
        if value is self.given:
            return None
        time.sleep(REST_S)
        self.given = value
        return value


class ServerTls:
    """TLS for a gRPC port. The files are checked whenever a client connects; open connections keep theirs."""

    def __init__(self, files: TlsFiles) -> None:
        """Raises SettingError."""
        try:
            self._watched = Watched("certificates", files.paths, files.read)
        except (ValueError, OSError) as error:
            raise SettingError(f"TLS cannot be served: {error}") from error
        self._asks_clients = bool(files.client_ca)

    def credentials(self) -> grpc.ServerCredentials:
        """Credentials for one port: they remember which certificates they gave it."""
        renewal = Renewal(self._watched)
        return grpc.dynamic_ssl_server_credentials(
            renewal.given,
            renewal,  # type: ignore[arg-type]  # the stubs do not know that it may return None
            require_client_authentication=self._asks_clients,
        )


def server_context(files: TlsFiles) -> ssl.SSLContext:
    """TLS for a port that is not gRPC; the files are checked for changes in every handshake. Raises SettingError."""

    def read() -> ssl.SSLContext:
        check_pair(files.certificate, files.key)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(files.certificate, files.key)
        return context

    try:
        watched = Watched("certificates of operations", (files.certificate, files.key), read)
    except (ValueError, OSError) as error:
        raise SettingError(f"TLS cannot be served: {error}") from error
    first = watched.value

    def renew(handshake: ssl.SSLObject | ssl.SSLSocket, _name: str | None, _context: ssl.SSLContext) -> None:
        watched.look()
        handshake.context = watched.value

    first.sni_callback = renew  # it is called whether the client sends a name or not
    return first


def check_pair(certificate: str, key: str) -> None:
    """Raise ValueError unless a certificate and a key belong together, OSError if one cannot be read."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key, password=_no_password)
    except ssl.SSLError as error:
        message = f"{certificate} and {key} are not a certificate and its key, in PEM ({_words(error)})"
        raise ValueError(message) from error


def check_authorities(path: str) -> None:
    """Raise ValueError unless a file holds certificates of authorities, OSError if it cannot be read."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    try:
        context.load_verify_locations(path)
    except ssl.SSLError as error:
        raise ValueError(f"{path} holds no certificates of authorities, in PEM ({_words(error)})") from error
    if not context.get_ca_certs():
        raise ValueError(f"{path} holds certificates, but none of a certificate authority")


def _no_password() -> str:
    raise ValueError("the key is encrypted; give one that is not, in a file that only the server's user can read")


def _words(error: ssl.SSLError) -> str:
    return (error.reason or str(error)).lower().replace("_", " ")
