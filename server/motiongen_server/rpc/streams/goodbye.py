"""Goodbye: tells a client that its stream will end, and when; once for each reason."""

from __future__ import annotations

from motiongen.v1 import service_pb2
from motiongen_server.rpc.streams.stream import Stream

EXPIRY_NOTICE_S = 10.0
"""How long before its credentials expire a client is told."""


def say_draining(stream: Stream, model_id: str, grace_s: float, reconnect_after_s: float = 0.0) -> None:
    """The server is going away. reconnect_after_s: when another server, or this one again, is available; 0: now.

    Names servers with room for sessions of the model, drawn anew for each stream: otherwise all would go to the same.
    """
    goodbye = _goodbye(service_pb2.GOODBYE_REASON_DRAINING, grace_s)
    if reconnect_after_s > 0:
        goodbye.reconnect_after.FromMilliseconds(round(1000 * reconnect_after_s))
    for address, routing_key in stream.other_servers(model_id):
        goodbye.other_servers.add(address=address, routing_key=routing_key)
    _say(stream, goodbye)


def say_expiring(stream: Stream, grace_s: float) -> None:
    """The client's credentials are about to expire."""
    _say(stream, _goodbye(service_pb2.GOODBYE_REASON_CREDENTIALS_EXPIRING, grace_s))


def _say(stream: Stream, goodbye: service_pb2.Goodbye) -> None:
    if goodbye.reason not in stream.goodbyes:
        stream.goodbyes.add(goodbye.reason)
        stream.reply(service_pb2.StreamMotionResponse(goodbye=goodbye))


def _goodbye(reason: service_pb2.GoodbyeReason, grace_s: float) -> service_pb2.Goodbye:
    goodbye = service_pb2.Goodbye(reason=reason)
    goodbye.grace.FromMilliseconds(max(0, round(1000 * grace_s)))
    return goodbye
