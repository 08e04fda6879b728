"""Target: a server under test, reached over one connection. Scene: sessions on it that a test may mistreat."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from functools import partial

import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc
from motiongen_compliance.talk import LIMIT_S, Talk

"""For the catalogue."""


@dataclass
class Target:
    """A server under test, reached over one connection."""

    stub: service_pb2_grpc.MotionServiceStub
    catalog: service_pb2.GetCatalogResponse

    def stream(self) -> Talk:
        """A new stream on which nothing has been said."""
        return Talk(self.stub, self.catalog)

    async def talk(self) -> Talk:
        """A new stream on which both sides have said hello."""
        return await self.stream().hello()


@dataclass
class Scene:
    """A session at 1 for a test to mistreat, one at 2 on the same stream, and one at 1 on another stream."""

    talk: Talk
    other: Talk

    async def others_play_on(self) -> None:
        await self.talk.plays_on(2)
        await self.other.plays_on(1)


async def connect(
    address: str, credentials: grpc.ChannelCredentials | None = None, token: str = "", through: str = ""
) -> AsyncIterator[Target]:
    """A connection for as long as it is iterated.

    credentials: None speaks plain text. token: "" for none. through: an address that leads to the server's, if not "".
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
        if token:
            for name in ("GetCatalog", "GenerateClip", "StreamMotion"):
                setattr(stub, name, partial(getattr(stub, name), metadata=(("authorization", f"Bearer {token}"),)))
        request = service_pb2.GetCatalogRequest()
        yield Target(stub, await stub.GetCatalog(request, timeout=LIMIT_S))
