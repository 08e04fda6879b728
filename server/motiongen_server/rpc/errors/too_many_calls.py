"""Refusals of calls that exceed a limit: all have the reason TOO_MANY_CALLS, and differ in their messages."""

from __future__ import annotations

import grpc

from motiongen_server.errors import StreamRefused

_OPEN_FOR_S = 1.0
"""The retry delay where it is not known when an open call will end."""
_LEAST_S = 0.1


def too_many_calls(wait_s: float, kind: str) -> StreamRefused:
    return _refused(f"your {kind} asks for too much (quota calls_per_second); ask again in {wait_s:.1f} s", wait_s)


def too_much_loop_time(wait_s: float, kind: str) -> StreamRefused:
    """The caller's peer owes for the event loop time that its requests took."""
    message = f"requests of your {kind} took more than its share of the server's time; ask again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_health_checks(wait_s: float) -> StreamRefused:
    message = f"too many health checks of your connection are waiting; ask again in {wait_s:.1f} s, or use Watch"
    return _refused(message, wait_s)


def too_many_bad_tokens(wait_s: float) -> StreamRefused:
    """The connection owes for checks of signed tokens that turned out invalid."""
    message = f"too many tokens sent over your connection were invalid; send yours again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_long_headers(wait_s: float) -> StreamRefused:
    message = f"calls of your address had more headers than are allowed; ask again in {wait_s:.1f} s"
    return _refused(message, wait_s)


def too_many_calls_open(most: int, kind: str = "") -> StreamRefused:
    """kind: that of the peer whose quota is used up; "": the server's own limit is."""
    whose = f"your {kind} has as many calls open as it may" if kind else "there are as many calls open as there may be"
    return _refused(f"{whose}, {most}; read the answers to earlier ones, or try again later", _OPEN_FOR_S)


def too_much_reflection(wait_s: float) -> StreamRefused:
    return _refused(f"your address asks for more reflection than it may; ask again in {wait_s:.1f} s", wait_s)


def _refused(message: str, wait_s: float) -> StreamRefused:
    retry_after_s = max(_LEAST_S, wait_s)
    return StreamRefused(grpc.StatusCode.RESOURCE_EXHAUSTED, "TOO_MANY_CALLS", message, retry_after_s=retry_after_s)
