"""gRPC calls as bytes, with headers that no gRPC client sends."""

from __future__ import annotations

import socket
import struct

from tests.waiting import LIMIT_S

Header = tuple[bytes, bytes]

PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
HEADERS, SETTINGS = 1, 4
END_OF_STREAM, END_OF_HEADERS = 1, 4


def answer_to(port: int, path: bytes, *more: Header) -> bytes:
    """What a local server sends to a call without a request, up to its status, or until it closes the connection.

    more: headers besides those of every call, each part shorter than 127 bytes.
    """
    with socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S) as connection:
        connection.sendall(beginning() + call_of(1, path, *more))
        answer = b""
        try:
            while b"grpc-message" not in answer and (received := connection.recv(4096)):
                answer += received
        except ConnectionResetError:
            pass
    return answer


def beginning() -> bytes:
    """What a client sends first on a connection."""
    return PREFACE + frame(SETTINGS, 0, 0, b"")


def call_of(stream: int, path: bytes, *more: Header) -> bytes:
    """A call without a request. stream: its number on the connection, odd and rising; path, more: as in `answer_to`."""
    usual = ((b":method", b"POST"), (b":scheme", b"http"), (b":path", path), (b":authority", b"localhost"))
    headers = (*usual, (b"te", b"trailers"), (b"content-type", b"application/grpc"), *more)
    return frame(HEADERS, END_OF_STREAM | END_OF_HEADERS, stream, b"".join(_literal(*header) for header in headers))


def status_in(answer: bytes) -> int | None:
    """The status code in an answer; None if there is none."""
    _, name, after = answer.partition(b"grpc-status")
    return int(after[1 : 1 + after[0]]) if name else None


def _literal(name: bytes, value: bytes) -> bytes:
    """A header written literally, without indexing (RFC 7541, 6.2.2)."""
    return b"\x00" + bytes([len(name)]) + name + bytes([len(value)]) + value


def frame(kind: int, flags: int, stream: int, content: bytes) -> bytes:
    """An HTTP/2 frame (RFC 9113, 4.1)."""
    return struct.pack(">I", len(content))[1:] + bytes([kind, flags]) + struct.pack(">I", stream) + content
