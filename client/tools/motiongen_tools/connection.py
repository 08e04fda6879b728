"""Command-line options for servers that use TLS or authenticate their callers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import grpc
import grpc.aio

from motiongen_client.channel import names_for_tls
from motiongen_client.client import MotionClient
from motiongen_client.errors import InvalidInput
from motiongen_client.line_policy import LinePolicy
from motiongen_tools.arguments import number_above_zero

RECOVER_S = 30.0
"""How long a command tries to reconnect to a server: there may be nobody to end one that waits for ever."""


@dataclass(frozen=True)
class Pem:
    """Contents of the TLS files; empty if there is no file."""

    authorities: bytes
    certificate: bytes
    key: bytes


@dataclass(frozen=True)
class Connection:
    """How to reach a server, except its address. Can be sent to other processes. The default is plain text, no token.

    authorities: PEM file of trusted certificate authorities, None for the system's. certificate, key: PEM files of the
    client's certificate. token_file: read again for every call, so that a token that expires can be replaced.
    connect_timeout_s: how long to wait for a server that is not up yet.
    """

    tls: bool = False
    authorities: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    token_file: Path | None = None
    connect_timeout_s: float = 10.0

    def client(self, address: str, policy: LinePolicy | None = None) -> MotionClient:
        """A client for a server, not connected yet. Raises InvalidInput.

        policy: by default, the client fails if its connection is lost and none can be made for RECOVER_S.
        """
        token = None
        if self.token_file is not None:
            self.token()  # reports a missing file now
            token = self.token
        return MotionClient(
            address,
            credentials=self.credentials(),
            token=token,
            connect_timeout_s=self.connect_timeout_s,
            policy=policy or LinePolicy(recover_s=RECOVER_S),
        )

    def channel(self, address: str, options: Sequence[tuple[str, int]]) -> grpc.aio.Channel:
        """A plain gRPC channel; its calls need `metadata`. Raises InvalidInput."""
        credentials = self.credentials()
        if credentials is None:
            return grpc.aio.insecure_channel(address, options=options)
        names = names_for_tls(address, (name for name, _ in options))
        return grpc.aio.secure_channel(address, credentials, options=[*options, *names])

    def metadata(self) -> tuple[tuple[str, str], ...]:
        """The metadata of a call. Raises InvalidInput."""
        return () if self.token_file is None else (("authorization", f"Bearer {self.token()}"),)

    def credentials(self) -> grpc.ChannelCredentials | None:
        """TLS credentials; None for plain text. Raises InvalidInput."""
        if not self.tls:
            return None
        pem = self.pem()
        return grpc.ssl_channel_credentials(pem.authorities or None, pem.key or None, pem.certificate or None)

    def pem(self) -> Pem:
        """The contents of the TLS files. Raises InvalidInput."""
        return Pem(
            *(
                b"" if path is None else _read_pem(name, path)
                for name, path in (
                    ("tls-ca", self.authorities), ("tls-certificate", self.certificate), ("tls-key", self.key),
                )
            )
        )  # fmt: skip

    def token(self) -> str:
        """The token in the file, without surrounding white space. Raises InvalidInput."""
        assert self.token_file is not None
        return _read("token-file", self.token_file).decode("utf-8-sig", "replace").strip()


PLAIN = Connection()


def add_connection(parser: argparse.ArgumentParser) -> None:
    """Add the options for TLS and for the token."""
    group = parser.add_argument_group("connection", "for a server that uses TLS, or authenticates its callers")
    group.add_argument("--tls", action="store_true", help="use TLS, and trust the system's certificate authorities")
    group.add_argument("--tls-ca", type=Path, metavar="FILE", help="use TLS, and trust those in this PEM file")
    group.add_argument("--tls-certificate", type=Path, metavar="FILE", help="PEM file of the client's certificate")
    group.add_argument("--tls-key", type=Path, metavar="FILE", help="PEM file of its key")
    group.add_argument(
        "--connect-timeout", type=number_above_zero, default=PLAIN.connect_timeout_s, metavar="S",
        help="seconds to wait for a server that is not up yet (default %(default)g)",
    )  # fmt: skip
    add_token(group)


def add_token(parser: argparse._ActionsContainer) -> None:
    """Add --token-file."""
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="file with the caller's token")


def check_started(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """If options do not fit the server that is used, one started by the command or not, print why and exit with 2."""
    is_own: bool = options.start_server if "start_server" in options else options.server is None
    if not is_own and getattr(options, "start_timeout", None) is not None:
        given = "leave --server out" if "start_server" not in options else "give --start-server too"
        parser.error(f"--start-timeout is for a server that this starts: {given}")
    if not is_own or "server_arguments" in options:  # its settings may turn TLS and authentication on
        return
    for name in ("tls", "tls_ca", "tls_certificate", "tls_key", "token_file"):
        if getattr(options, name, None):
            parser.error(
                f"--{name.replace('_', '-')} is for a server that is running already: the one started here needs none"
            )


def connection_of(options: argparse.Namespace) -> Connection:
    """The connection that the options describe. Raises InvalidInput if they do not fit together."""
    certificate, key = options.tls_certificate, options.tls_key
    if (certificate is None) != (key is None):
        raise InvalidInput("tls-certificate", str(certificate), "it and --tls-key together")
    tls = options.tls or options.tls_ca is not None or certificate is not None
    return Connection(tls, options.tls_ca, certificate, key, options.token_file, options.connect_timeout)


def client_of(options: argparse.Namespace, address: str, policy: LinePolicy | None = None) -> MotionClient:
    """A client, as from Connection.client. Raises InvalidInput."""
    return connection_of(options).client(address, policy)


def read_token(path: Path | None) -> str | None:
    """The token in a file, without surrounding white space; None without a file. Raises InvalidInput."""
    return None if path is None else Connection(token_file=path).token()


def _read_pem(name: str, path: Path) -> bytes:
    """Checked here because gRPC would only report that it cannot connect."""
    data = _read(name, path)
    if b"-----BEGIN " not in data:
        raise InvalidInput(name, str(path), "a PEM file, which is text with a line that begins with -----BEGIN")
    return data


def _read(name: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(name, str(path), f"a file that can be read ({error.strerror})") from error
