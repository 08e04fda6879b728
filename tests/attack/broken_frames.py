"""HTTP/2 frames that RFC 9113 forbids, and frames that it allows but no gRPC client sends."""

from __future__ import annotations

import struct

from tests.raw_calls import END_OF_HEADERS, END_OF_STREAM, HEADERS, SETTINGS, call_of, frame

DATA, PRIORITY, RST_STREAM, PUSH_PROMISE, PING, GOAWAY, WINDOW_UPDATE, CONTINUATION = 0, 2, 3, 5, 6, 7, 8, 9
UNKNOWN = 0xB7
ACK, PADDED = 1, 8
INITIAL_WINDOW_SIZE, MAX_FRAME_SIZE, ENABLE_PUSH = 4, 5, 2
LARGEST_WINDOW = (1 << 31) - 1
CALLED, NEVER_CALLED = 1, 9
"""HTTP/2 streams: one on which a call was made before the frames here, and one that stays unused."""
UNSERVED = b"/nobody.Serves/This"


def number(value: int) -> bytes:
    """A number of four bytes, as in most frames."""
    return struct.pack(">I", value)


def setting(kind: int, value: int) -> bytes:
    return struct.pack(">HI", kind, value)


def with_headers(block: bytes, stream: int = 3, flags: int = END_OF_STREAM | END_OF_HEADERS) -> bytes:
    return frame(HEADERS, flags, stream, block)


UNREADABLE_TIMEOUT = call_of(3, UNSERVED, (b"grpc-timeout", b"soon"))
"""gRPC logs that it cannot read this timeout, unless its logging is switched off."""

FORBIDDEN = (
    frame(SETTINGS, 0, 0, b"abc"),
    frame(SETTINGS, 0, CALLED, b""),
    frame(SETTINGS, ACK, 0, setting(MAX_FRAME_SIZE, 1 << 14)),
    frame(SETTINGS, 0, 0, setting(INITIAL_WINDOW_SIZE, 1 << 31)),
    frame(SETTINGS, 0, 0, setting(MAX_FRAME_SIZE, 1)),
    frame(SETTINGS, 0, 0, setting(ENABLE_PUSH, 2)),
    frame(WINDOW_UPDATE, 0, 0, b"abc"),
    frame(WINDOW_UPDATE, 0, 0, number(0)),
    frame(WINDOW_UPDATE, 0, CALLED, number(0)),
    frame(WINDOW_UPDATE, 0, NEVER_CALLED, number(1)),
    frame(WINDOW_UPDATE, 0, 0, number(LARGEST_WINDOW)) * 3,
    frame(WINDOW_UPDATE, 0, CALLED, number(LARGEST_WINDOW)) * 3,
    frame(DATA, 0, 0, b"abc"),
    frame(DATA, 0, NEVER_CALLED, b"abc"),
    frame(DATA, 0, CALLED, b"abc"),  # after the end of that stream
    frame(DATA, PADDED, CALLED, b"\xffabc"),
    with_headers(b"", stream=0),
    with_headers(b"", stream=2),
    with_headers(b"", stream=CALLED),
    with_headers(b"\xff\xff\xff\xff\x7f"),  # an index that is not in the table
    with_headers(b"\xff\xff\xff\xff\xff\xff\xff\xff\x7f"),
    with_headers(b"\x3f\xff\xff\xff\x7f"),  # a table of half a gigabyte
    with_headers(b"\x00\x7f\xff\xff\xff\x7fk"),  # a name longer than the frame
    with_headers(b"\x00\x81\xff\x00"),  # Huffman-coded, with nothing but padding
    with_headers(b"\xffabc", flags=END_OF_HEADERS | PADDED),
    with_headers(b"\x82", flags=END_OF_STREAM) + frame(PING, 0, 0, bytes(8)),
    with_headers(b"\x82", flags=END_OF_STREAM) + frame(CONTINUATION, END_OF_HEADERS, 5, b"\x82"),
    frame(CONTINUATION, END_OF_HEADERS, 3, b"\x82"),
    frame(PUSH_PROMISE, END_OF_HEADERS, CALLED, number(2) + b"\x82"),
    frame(RST_STREAM, 0, 0, number(8)),
    frame(RST_STREAM, 0, NEVER_CALLED, number(8)),
    frame(RST_STREAM, 0, CALLED, b"abc"),
    frame(PING, 0, 0, b"abc"),
    frame(PING, 0, CALLED, bytes(8)),
    frame(GOAWAY, 0, 0, b"abc"),
    frame(GOAWAY, 0, CALLED, bytes(8)),
    frame(GOAWAY, 0, 0, number(LARGEST_WINDOW) + number(0)) * 2 + call_of(3, UNSERVED),
    frame(PRIORITY, 0, CALLED, b"abc"),
    frame(PRIORITY, 0, 3, number(3) + b"\x10"),  # a stream that depends on itself
    b"\xff\xff\xff" + frame(UNKNOWN, 0, 0, b"abc")[3:],  # the largest length that a frame header can state
    UNREADABLE_TIMEOUT,
)

NEEDLESS = (
    frame(PRIORITY, 0, NEVER_CALLED, number(0) + b"\x10"),
    frame(PRIORITY, 0, CALLED, number(NEVER_CALLED) + b"\xff"),
    frame(UNKNOWN, 0xFF, 0, bytes(64)),
    frame(UNKNOWN, 0, CALLED, b""),
    frame(WINDOW_UPDATE, 0, 0, number(1)),
    frame(WINDOW_UPDATE, 0, CALLED, number(1)),
    frame(SETTINGS, 0, 0, b""),
    frame(SETTINGS, 0, 0, setting(0xF00D, 1) + setting(INITIAL_WINDOW_SIZE, 1 << 16)),
    frame(PING, ACK, 0, bytes(8)),
    frame(RST_STREAM, 0, CALLED, number(8)),
)
