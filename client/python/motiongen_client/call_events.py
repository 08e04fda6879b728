"""CallEvents: what a stream is told of its calls."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass

import grpc.aio

from motiongen.v1 import service_pb2
from motiongen_client.errors import MotiongenError


@dataclass(frozen=True)
class CallEvents:
    """The stream's callbacks for events of its calls.

    take: called with each response. greeted: hellos were exchanged on a new channel; awaited before the call counts as
    connected. begun: there is a call. lost: it is gone; returns whether another is needed at once, otherwise one is
    made when something waits for it. over: there will be no more calls.
    """

    take: Callable[[service_pb2.StreamMotionResponse], None]
    greeted: Callable[[grpc.aio.Channel], Awaitable[None]]
    begun: Callable[[], None]
    lost: Callable[[], bool]
    over: Callable[[MotiongenError], None]
