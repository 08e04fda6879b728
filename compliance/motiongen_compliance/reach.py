"""Reach: find out whether the server at an address can be tested at all, and if not, why."""

from __future__ import annotations

import asyncio
import codecs
import socket
from pathlib import Path

import grpc
import grpc.aio
from google.rpc import error_details_pb2  # type: ignore[import-untyped]
from grpc_status import rpc_status

from motiongen_compliance.target import connect

PROBE_S = 5.0
"""How long to wait for a connection, and for the first bytes on it."""
_HTTP2_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + b"\x04" + bytes(5)
"""The HTTP/2 preface and an empty SETTINGS frame (RFC 9113, 3.4 and 6.5)."""
_FRAME_HEADER_BYTES, _SETTINGS = 9, 4
_TLS_ALERT = b"\x15\x03"


class Unreachable(Exception):
    """Nothing can be tested. The message says why, and what to do."""


def credentials_of(
    authorities: Path | None, key: Path | None = None, certificate: Path | None = None
) -> grpc.ChannelCredentials | None:
    """TLS credentials from PEM files. None, which means plain text, if there are no authorities to trust."""
    if authorities is None:
        return None
    shown = [None if path is None else path.read_bytes() for path in (key, certificate)]
    return grpc.ssl_channel_credentials(authorities.read_bytes(), *shown)


def token_of(path: Path | None) -> str:
    """The token in a file; "" without a file. Raises ValueError if the file has no token."""
    if path is None:
        return ""
    token = path.read_bytes().removeprefix(codecs.BOM_UTF8).decode("ascii", "replace").strip()
    if not token or not (token.isascii() and token.isprintable()):
        raise ValueError(f"{path} has no token: one line of printable ASCII")
    return token


async def reach(address: str, credentials: grpc.ChannelCredentials | None = None, token: str = "") -> None:
    """Ask for the catalogue once. credentials, token: as for `connect`. Raises Unreachable if that fails."""
    try:
        async for target in connect(address, credentials, token):
            served = {rig.rig_id for rig in target.catalog.rigs}
            if not target.catalog.models or target.catalog.models[0].rig_id not in served:
                raise Unreachable(f"the catalogue of {address} has no model, or lacks the rig of its first model")
    except grpc.aio.AioRpcError as error:
        raise Unreachable(await _why(error, address, credentials is not None)) from error


async def _why(error: grpc.aio.AioRpcError, address: str, is_tls: bool) -> str:
    code, details, reason = error.code(), error.details() or "no details", reason_of(error)
    said = f"{address} answers GetCatalog with {code.name}" + (f" ({reason})" if reason else "") + f": {details}"
    if code is grpc.StatusCode.UNAUTHENTICATED:
        return f"{said}; authenticate by --token-file, or by --certificate and --key"
    if code is grpc.StatusCode.UNIMPLEMENTED:
        return f"{address} speaks gRPC, but has no motiongen.v1.MotionService: {details}"
    if reason or code is grpc.StatusCode.RESOURCE_EXHAUSTED:
        return said
    host, _, port = address.rpartition(":")
    found = await asyncio.to_thread(_spoken, host.strip("[]"), int(port), is_tls)
    return f"{found} (gRPC says {code.name}: {details})"


def reason_of(error: grpc.aio.AioRpcError) -> str:
    """The reason that the server gave for a status; "" if it gave none, or if the status is not the server's own."""
    try:
        status = rpc_status.from_call(error)  # type: ignore[arg-type]  # it has the parts of a call that are used
    except ValueError:  # the details belong to another status
        return ""
    info = error_details_pb2.ErrorInfo()
    return next((info.reason for detail in (status.details if status else ()) if detail.Unpack(info)), "")


def _spoken(host: str, port: int, is_tls: bool) -> str:
    """What is at the address instead of a motiongen server, found out without gRPC."""
    where = f"{host}:{port}"
    try:
        line = socket.create_connection((host, port), PROBE_S)
    except socket.gaierror as error:
        return f"{host} is not a host that can be found: {error.strerror}"
    except TimeoutError:
        return f"{where} accepts no connection within {PROBE_S:g} s"
    except OSError as error:
        return f"nothing can be reached at {where}: {error.strerror or error}"
    with line:
        if is_tls:
            return f"{where} accepts connections, but no call over TLS with these files"
        try:
            line.sendall(_HTTP2_HELLO)
            first = line.recv(64)
        except TimeoutError:
            return f"{where} accepts connections, but sends nothing"
        except OSError:
            first = b""
    if not first:
        return f"{where} closes plain-text connections; if it requires TLS, give --ca"
    if first.startswith(_TLS_ALERT):
        return f"{where} requires TLS; give --ca"
    if first.startswith(b"HTTP/1"):
        return f"{where} speaks HTTP/1, but gRPC needs HTTP/2"
    if len(first) >= _FRAME_HEADER_BYTES and first[3] == _SETTINGS:
        return f"{where} speaks HTTP/2, but does not answer gRPC calls correctly"
    return f"{where} does not speak HTTP/2; its first bytes are {first[:16]!r}"
