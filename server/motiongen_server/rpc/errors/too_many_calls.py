"""Why a call is refused as one too many, in words for programs and for people: all of them with TOO_MANY_CALLS."""

from __future__ import annotations

import grpc

from motiongen_server.errors import StreamRefused

_OPEN_FOR_S = 1.0
"""Where nobody knows when one of those that are open will end."""
_LEAST_S = 0.1


def too_many_calls(wait_s: float, kind: str) -> StreamRefused:
    return _refused(f"your {kind} asks for too much (quota calls_per_second); ask again in {wait_s:.1f} s", wait_s)


def too_much_loop_time(wait_s: float, kind: str) -> StreamRefused:
    """Of a call, whose peer owes for what its requests took of the gateway's event loop."""
    message = f"what your {kind} asked for took more of the server than its part; ask again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_health_checks(wait_s: float) -> StreamRefused:
    message = f"too many health checks of your connection wait; ask again in {wait_s:.1f} s, or watch the health"
    return _refused(message, wait_s)


def too_many_bad_tokens(wait_s: float) -> StreamRefused:
    """Of signed tokens, whose checks a connection owes for."""
    message = f"too many tokens that came over your connection do not hold; show yours again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_long_headers(wait_s: float) -> StreamRefused:
    message = f"calls of your address had more headers than are allowed; ask again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_calls_open(most: int, kind: str = "") -> StreamRefused:
    """kind: of the peer whose quota it is; "": the server's own limit."""
    whose = f"your {kind} has as many calls open as it may" if kind else "there are as many calls open as there may be"
    return _refused(f"{whose}, {most}; read what earlier ones were answered, or come back later", _OPEN_FOR_S)


def too_much_reflection(wait_s: float) -> StreamRefused:
    return _refused(f"your address asks for more reflection than it may; ask again in {wait_s:.1f} s", wait_s)


def _refused(message: str, wait_s: float) -> StreamRefused:
    retry_after_s = max(_LEAST_S, wait_s)
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS", message, retry_after_s=retry_after_s)
