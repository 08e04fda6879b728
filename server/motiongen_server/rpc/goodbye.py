"""Goodbye: a client is told that its stream will end, and when."""

from __future__ import annotations

from motiongen.v1 import service_pb2
from motiongen_server.rpc.stream import Stream

EXPIRY_NOTICE_S = 10.0
"""How long before its credentials expire a client is told."""


def say_draining(stream: Stream, grace_s: float, reconnect_after_s: float = 0.0) -> None:
    """The server goes away. reconnect_after_s: when another one, or it itself, can be had; 0: at once."""
    _say(stream, service_pb2.GOODBYE_REASON_DRAINING, grace_s, reconnect_after_s)


def say_expiring(stream: Stream, grace_s: float) -> None:
    """The client's credentials are about to expire."""
    _say(stream, service_pb2.GOODBYE_REASON_CREDENTIALS_EXPIRING, grace_s)


def _say(stream: Stream, reason: service_pb2.GoodbyeReason, grace_s: float, reconnect_after_s: float = 0.0) -> None:
    goodbye = service_pb2.Goodbye(reason=reason)
    goodbye.grace.FromMilliseconds(max(0, round(1000 * grace_s)))
    if reconnect_after_s > 0:
        goodbye.reconnect_after.FromMilliseconds(round(1000 * reconnect_after_s))
    stream.reply(service_pb2.StreamMotionResponse(goodbye=goodbye))
