"""Options by which the commands reach a server that speaks TLS and asks who calls."""

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
"""How long a command tries to reach a server that it has lost: nobody may be there to end one that waits for ever."""


@dataclass(frozen=True)
class Pem:
    """The files of TLS; empty where there is none."""

    authorities: bytes
    certificate: bytes
    key: bytes


@dataclass(frozen=True)
class Connection:
    """How a server is reached, but for its address; crosses to other processes. The default is plain text, no token.

    authorities: PEM file of those that are trusted, None for those of the system. certificate, key: PEM files of what
    the client shows. token_file: read anew for every call, so that one that expires is followed by the next.
    connect_timeout_s: how long to wait for a server that is not there yet.
    """

    tls: bool = False
    authorities: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    token_file: Path | None = None
    connect_timeout_s: float = 10.0

    def client(self, address: str, policy: LinePolicy | None = None) -> MotionClient:
        """A client for a server, not connected yet. Raises InvalidInput.

        policy: by default it fails where its line was lost and none is to be had for RECOVER_S.
        """
        token = None
        if self.token_file is not None:
            self.token()  # a file that is not there is told now
            token = self.token
        return MotionClient(
            address,
            credentials=self.credentials(),
            token=token,
            connect_timeout_s=self.connect_timeout_s,
            policy=policy or LinePolicy(recover_s=RECOVER_S),
        )

    def channel(self, address: str, options: Sequence[tuple[str, int]]) -> grpc.aio.Channel:
        """A channel of gRPC's own, whose calls need `metadata`. Raises InvalidInput."""
        credentials = self.credentials()
        if credentials is None:
            return grpc.aio.insecure_channel(address, options=options)
        names = names_for_tls(address, (name for name, _ in options))
        return grpc.aio.secure_channel(address, credentials, options=[*options, *names])

    def metadata(self) -> tuple[tuple[str, str], ...]:
        """What a call carries. Raises InvalidInput."""
        return () if self.token_file is None else (("authorization", f"Bearer {self.token()}"),)

    def credentials(self) -> grpc.ChannelCredentials | None:
        """None: plain text. Raises InvalidInput."""
        if not self.tls:
            return None
        pem = self.pem()
        return grpc.ssl_channel_credentials(pem.authorities or None, pem.key or None, pem.certificate or None)

    def pem(self) -> Pem:
        """What its files of TLS hold. Raises InvalidInput."""
        return Pem(
            *(
                b"" if path is None else _read_pem(name, path)
                for name, path in (
                    ("tls-ca", self.authorities), ("tls-certificate", self.certificate), ("tls-key", self.key),
                )
            )
        )  # fmt: skip

    def token(self) -> str:
        """What its file holds, less the space around it. Raises InvalidInput."""
        assert self.token_file is not None
        return _read("token-file", self.token_file).decode(errors="replace").strip()


PLAIN = Connection()


def add_connection(parser: argparse.ArgumentParser) -> None:
    """The options of TLS and of the token."""
    group = parser.add_argument_group("connection", "for a server that speaks TLS, or asks who calls")
    group.add_argument("--tls", action="store_true", help="speak TLS, and trust the authorities of this system")
    group.add_argument("--tls-ca", type=Path, metavar="FILE", help="speak TLS, and trust those of this PEM file")
    group.add_argument("--tls-certificate", type=Path, metavar="FILE", help="PEM file of the certificate to show")
    group.add_argument("--tls-key", type=Path, metavar="FILE", help="PEM file of its key")
    group.add_argument(
        "--connect-timeout", type=number_above_zero, default=PLAIN.connect_timeout_s, metavar="S",
        help="seconds to wait for a server that is not there yet (default %(default)g)",
    )  # fmt: skip
    add_token(group)


def add_token(parser: argparse._ActionsContainer) -> None:
    """--token-file."""
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="file with the token that says who calls")


def check_started(parser: argparse.ArgumentParser, options: argparse.Namespace) -> None:
    """Exit with 2, and say why, where options are for another server than the one that is started, or not."""
    is_own: bool = options.start_server if "start_server" in options else options.server is None
    if not is_own and getattr(options, "start_timeout", None) is not None:
        given = "leave --server out" if "start_server" not in options else "give --start-server too"
        parser.error(f"--start-timeout is for a server that this starts: {given}")
    if not is_own or "server_arguments" in options:  # settings of its own may have it speak TLS and ask who calls
        return
    for name in ("tls", "tls_ca", "tls_certificate", "tls_key", "token_file"):
        if getattr(options, name, None):
            parser.error(
                f"--{name.replace('_', '-')} is for a server that is there: the one that this starts needs none"
            )


def connection_of(options: argparse.Namespace) -> Connection:
    """What the options say. Raises InvalidInput where they do not fit together."""
    certificate, key = options.tls_certificate, options.tls_key
    if (certificate is None) != (key is None):
        raise InvalidInput("tls-certificate", str(certificate), "it and --tls-key together")
    tls = options.tls or options.tls_ca is not None or certificate is not None
    return Connection(tls, options.tls_ca, certificate, key, options.token_file, options.connect_timeout)


def client_of(options: argparse.Namespace, address: str, policy: LinePolicy | None = None) -> MotionClient:
    """As Connection.client. Raises InvalidInput."""
    return connection_of(options).client(address, policy)


def read_token(path: Path | None) -> str | None:
    """What the file holds, less the space around it. Raises InvalidInput."""
    return None if path is None else Connection(token_file=path).token()


def _read_pem(name: str, path: Path) -> bytes:
    """gRPC would only say that it does not come through."""
    data = _read(name, path)
    if b"-----BEGIN " not in data:
        raise InvalidInput(name, str(path), "a PEM file, which is text with a line that begins with -----BEGIN")
    return data


def _read(name: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(name, str(path), f"a file that can be read ({error.strerror})") from error
