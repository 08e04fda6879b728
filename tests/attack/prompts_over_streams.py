"""Hostile clients at one address with new prompts on many streams, and in clips; see `tests.attack.hostile`.

The good clients have another address here: they connect through a relay that calls from its own address.
"""

from __future__ import annotations

import asyncio
import itertools
import random
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.calls import Event, Request, channel_to, for_ever

CONNECTIONS = 4
STREAMS = 80
"""Per connection: 320 in total, more than there are places for prompts that wait."""
CLIPS = 8
"""Per connection: as many as are allowed to have 32 samples under way."""
RETRY_S = 0.2


@asynccontextmanager
async def from_address(source: str, address: str) -> AsyncIterator[str]:
    """A port that relays its connections to an address, from another address of this machine."""
    host, _, port = address.rpartition(":")

    async def copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            while data := await reader.read(1 << 16):
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        from_server, to_server = await asyncio.open_connection(host, int(port), local_addr=(source, 0))
        await asyncio.gather(copy(reader, to_server), copy(from_server, writer))

    relay = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with relay:
        yield f"127.0.0.1:{relay.sockets[0].getsockname()[1]}"


async def edit_on(channel: grpc.aio.Channel, new_prompt: Callable[[], motion_pb2.PromptSpan]) -> None:
    """One session on its own stream, whose prompt changes again as soon as a change was answered."""
    call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
    opening = session_pb2.OpenSession(priority=session_pb2.PRIORITY_CLASS_BATCH)
    try:
        opens = [Event(session=1, event_seq=1, open=opening)]
        await call.write(Request(hello=service_pb2.ClientHello(client_agent="hostile"), events=opens))
        asked = 1
        while isinstance(response := await call.read(), service_pb2.StreamMotionResponse):
            for update in response.updates:
                if update.WhichOneof("update") == "outcome" and update.outcome.event_seq == 1:
                    await asyncio.sleep(RETRY_S)
                    return
                answered = update.outcome.event_seq if update.HasField("outcome") else update.HasField("opened")
                if answered == asked:
                    asked += 1
                    edit = session_pb2.EditPrompts(upsert=[new_prompt()])
                    await call.write(Request(events=[Event(session=1, event_seq=asked, edit_prompts=edit)]))
    finally:
        call.cancel()


async def clip_on(channel: grpc.aio.Channel, new_prompt: Callable[[], motion_pb2.PromptSpan]) -> None:
    """A short clip with a new prompt."""
    opening = session_pb2.OpenSession(prompts=[new_prompt()])
    request = service_pb2.GenerateClipRequest(open=opening, frame_count=8)
    async for _ in service_pb2_grpc.MotionServiceStub(channel).GenerateClip(request):
        pass


async def prompts_over_streams(address: str) -> None:
    """Sessions on a stream each, and clips, with one prompt after another that is new to the server."""
    numbers, name = itertools.count(), random.getrandbits(64)

    def new_prompt() -> motion_pb2.PromptSpan:
        return motion_pb2.PromptSpan(prompt_id=1, text=f"does {name} {next(numbers)}")

    async def connection(relay: str) -> None:
        async with channel_to(relay) as channel:
            streams = [for_ever(lambda: edit_on(channel, new_prompt)) for _ in range(STREAMS)]
            clips = [for_ever(lambda: clip_on(channel, new_prompt)) for _ in range(CLIPS)]
            await asyncio.gather(*streams, *clips)

    async with from_address(f"127.0.0.{random.randint(2, 250)}", address) as relay:
        await asyncio.gather(*(connection(relay) for _ in range(CONNECTIONS)))
