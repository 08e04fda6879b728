"""Target: a server under test, reached over one connection. Scene: sessions on it that a test may mistreat."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from functools import partial

import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.talk import LIMIT_S, Talk


@dataclass
class Target:
    """A server under test, reached over one connection."""

    stub: service_pb2_grpc.MotionServiceStub
    catalog: service_pb2.GetCatalogResponse
    channel: grpc.aio.Channel | None = None
    metadata: tuple[tuple[str, str], ...] = ()
    streams: list[Talk] = field(default_factory=list)

    def raw(self, method: str) -> grpc.aio.StreamStreamCall[bytes, bytes]:
        """A call of a method by its path, for sending bytes that are not messages. Needs the channel."""
        assert self.channel is not None
        return self.channel.stream_stream(method)(metadata=self.metadata, timeout=LIMIT_S)

    def stream(self) -> Talk:
        """A new stream on which nothing has been sent yet."""
        self.streams.append(Talk(self.stub, self.catalog))
        return self.streams[-1]

    async def talk(self) -> Talk:
        """A new stream on which both sides have sent hello."""
        return await self.stream().hello()


@dataclass
class Scene:
    """Three sessions: handle 1, which a test may mistreat, handle 2 on the same stream, handle 1 on another stream."""

    talk: Talk
    other: Talk

    async def others_play_on(self) -> None:
        await self.talk.plays_on(2)
        await self.other.plays_on(1)


async def connect(
    address: str, credentials: grpc.ChannelCredentials | None = None, token: str = "", through: str = ""
) -> AsyncIterator[Target]:
    """A connection to a server, open during the iteration.

    credentials: None for plain text. token: "" for none. through: the address of a relay to the server; "" to connect
    directly.
    """
    options: tuple[tuple[str, str | int], ...]
    options = (("grpc.max_receive_message_length", 8 << 20), ("grpc.use_local_subchannel_pool", 1))
    if through:
        options += (("grpc.default_authority", address), ("grpc.max_reconnect_backoff_ms", 1000))
        if credentials is not None:
            options += (("grpc.ssl_target_name_override", address.rpartition(":")[0].strip("[]")),)
        address = through
    if credentials is None:
        channel = grpc.aio.insecure_channel(address, options)
    else:
        channel = grpc.aio.secure_channel(address, credentials, options)
    async with channel:
        stub = service_pb2_grpc.MotionServiceStub(channel)
        metadata = (("authorization", f"Bearer {token}"),) if token else ()
        for name in ("GetCatalog", "GenerateClip", "StreamMotion") if token else ():
            setattr(stub, name, partial(getattr(stub, name), metadata=metadata))
        request = service_pb2.GetCatalogRequest()
        target = Target(stub, await stub.GetCatalog(request, timeout=LIMIT_S), channel, metadata)
        try:
            yield target
        finally:  # else the server would keep their sessions for resuming, and these count towards its limits
            await asyncio.gather(*(stream.finish() for stream in target.streams))
