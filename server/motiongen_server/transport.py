"""The options of the gRPC servers: how far they read ahead, how often they ping, how many connections they take."""

from __future__ import annotations

import resource
from pathlib import Path

import grpc.aio

from motiongen_server.config import ServerConfig
from motiongen_server.rpc.calls.call_pace import calls_a_second
from motiongen_server.rpc.grpc_server import make_server
from motiongen_server.rpc.limits import HEALTH_CALLS, OTHER_CALLS
from motiongen_server.settings import SettingError

MOST_PENDING = 4096
"""Calls of a method that have arrived and were not begun: gRPC begins them one after another, and cancels any beyond
this number at random."""
SPARE_CALLS = 256
"""Calls that are just being refused."""
RESERVED_FILES = 128
"""Descriptors for everything but clients: engine processes, operators' ports, logs, files that libraries open."""
ADMIN_CONNECTIONS = 16
"""Part of the reserved descriptors; the port of health and metrics has 64 (`ops.http`)."""
LEAST_CONNECTIONS = 32
MOST_FILES = 65_536
"""The limit is raised no further: some systems allow a billion, and libraries close them all one by one."""
HANDSHAKE_MS = 5_000
"""How soon a client that has connected must speak HTTP/2."""
READ_AHEAD_BYTES = 64 << 10
"""Read ahead of a stream while the server does not read it; the rest waits at its client."""


def make_grpc_server(config: ServerConfig) -> grpc.aio.Server:
    """A server without methods and ports. Raises SettingError if there are too few file descriptors."""
    return make_server(
        options=[
            ("grpc.max_receive_message_length", config.max_request_bytes),
            ("grpc.max_send_message_length", 8 << 20),
            ("grpc.max_concurrent_streams", 256),
            ("grpc.server.max_pending_requests", MOST_PENDING),
            ("grpc.server.max_pending_requests_hard_limit", MOST_PENDING),
            ("grpc.max_allowed_incoming_connections", allowed_connections()),
            ("grpc.server_handshake_timeout_ms", HANDSHAKE_MS),
            ("grpc.http2.lookahead_bytes", READ_AHEAD_BYTES),
            ("grpc.http2.bdp_probe", 0),
            ("grpc.keepalive_time_ms", round(1000 * config.keepalive_s)),
            ("grpc.keepalive_timeout_ms", round(1000 * config.keepalive_timeout_s)),
            ("grpc.keepalive_permit_without_calls", 1),
            ("grpc.http2.min_ping_interval_without_data_ms", round(1000 * config.min_ping_interval_s)),
            ("grpc.http2.max_ping_strikes", 4),
            ("grpc.so_reuseport", 0),
        ],
        # The sum of the limits of all kinds of calls. Each of these is enforced elsewhere, so that no kind takes all.
        most_calls=config.max_streams + config.max_clip_calls + OTHER_CALLS + HEALTH_CALLS + SPARE_CALLS,
        calls_a_second=calls_a_second(config.address_calls_per_second, config.peer_calls_per_second),
    )


def make_admin_server() -> grpc.aio.Server:
    """A server for the admin port. Operators are few: whoever else connects there takes no descriptors from clients."""
    return make_server(
        [
            ("grpc.max_allowed_incoming_connections", ADMIN_CONNECTIONS),
            ("grpc.server_handshake_timeout_ms", HANDSHAKE_MS),
            ("grpc.so_reuseport", 0),
        ]
    )


def allowed_connections() -> int:
    """How many clients may connect at once with enough descriptors left for all else. Raises the process's limit first.

    A server without free descriptors can neither accept nor refuse a connection, and tries again and again. Raises
    SettingError if there are too few from the start.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = MOST_FILES if hard == resource.RLIM_INFINITY else min(hard, MOST_FILES)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))
        soft = most
    total = MOST_FILES if soft == resource.RLIM_INFINITY else min(soft, MOST_FILES)
    allowed = total - open_files() - RESERVED_FILES
    if allowed < LEAST_CONNECTIONS:
        raise SettingError(
            f"this process may open {total} files; it needs {total - allowed + LEAST_CONNECTIONS} or more for "
            f"{LEAST_CONNECTIONS} clients: raise the limit (ulimit -n, LimitNOFILE)"
        )
    return allowed


def open_files() -> int:
    """How many descriptors this process has open; 0 if the system does not say."""
    try:
        return len(list(Path("/proc/self/fd").iterdir()))
    except OSError:  # no /proc
        return 0
