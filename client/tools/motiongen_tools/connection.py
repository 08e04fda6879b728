"""Options by which the commands reach a server that speaks TLS and asks who calls."""

from __future__ import annotations

import argparse
from pathlib import Path

import grpc

from motiongen_client.client import MotionClient
from motiongen_client.errors import InvalidInput


def add_connection(parser: argparse.ArgumentParser) -> None:
    """--tls-ca and --token-file."""
    parser.add_argument(
        "--tls-ca",
        type=Path,
        metavar="FILE",
        help="speak TLS, and trust the authorities in this PEM file (default: plain text)",
    )
    add_token(parser)


def add_token(parser: argparse.ArgumentParser) -> None:
    """--token-file."""
    parser.add_argument("--token-file", type=Path, metavar="FILE", help="file with the token that says who calls")


def client_of(options: argparse.Namespace, address: str) -> MotionClient:
    """A client for a server, not connected yet. Raises InvalidInput."""
    credentials = None
    if options.tls_ca is not None:
        credentials = grpc.ssl_channel_credentials(_read("tls-ca", options.tls_ca))
    return MotionClient(address, credentials=credentials, token=read_token(options.token_file))


def read_token(path: Path | None) -> str | None:
    """What the file holds, less the space around it. Raises InvalidInput."""
    return None if path is None else _read("token-file", path).decode(errors="replace").strip()


def _read(name: str, path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(name, str(path), f"a file that can be read ({error.strerror})") from error
