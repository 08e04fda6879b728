"""A hostile client that sends valid messages with some bytes changed."""

from __future__ import annotations

import asyncio
import contextlib
import random

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, session_pb2
from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.calls import HELLO, STREAMS, Event, Request, bare_stream, channel_to, drain, many

OTHERS = (
    f"/{SERVICE_NAME}/GetCatalog", "/grpc.health.v1.Health/Check", "/grpc.health.v1.Health/Watch",
    "/grpc.reflection.v1.ServerReflection/ServerReflectionInfo",
)  # fmt: skip
"""Methods whose requests are messages with one text."""


def mutated(data: bytes, chance: random.Random) -> bytes:
    """A message with some bytes changed, left out or doubled."""
    changed = bytearray(data)
    for _ in range(chance.randrange(1, 6)):
        at = chance.randrange(len(changed)) if changed else 0
        match chance.randrange(4):
            case 0 if changed:
                changed[at] = chance.randrange(256)
            case 1 if changed:
                changed[at] ^= 1 << chance.randrange(8)
            case 2:
                del changed[at : at + chance.randrange(1, 8)]
            case _:
                changed[at:at] = changed[at : at + chance.randrange(1, 32)]
    return bytes(changed)


async def mutations(address: str) -> None:
    """Valid messages with some bytes changed, on streams and as requests of all methods."""
    chance = random.Random(random.getrandbits(64))
    span = motion_pb2.PromptSpan(prompt_id=1, text="a person walks forward")
    waypoint = motion_pb2.Constraint(constraint_id=1, frame=40, waypoint=motion_pb2.Waypoint(x=1.0, z=2.0))
    opening = session_pb2.OpenSession(seed=1, prompts=[span], constraints=[waypoint], lookahead_frames=40)
    edit = session_pb2.EditConstraints(upsert=[waypoint])
    velocity = session_pb2.SetVelocity(x=1.0, hold_frames=20)
    good = [
        Request(events=[Event(session=2, event_seq=1, open=opening)]).SerializeToString(),
        Request(events=[Event(session=1, event_seq=2, edit_constraints=edit)]).SerializeToString(),
        Request(events=[Event(session=1, event_seq=2, set_velocity=velocity)]).SerializeToString(),
        Request(events=[Event(session=1, playhead=session_pb2.Playhead(frame=5, buffered_to=9))]).SerializeToString(),
        Request(ping=service_pb2.Ping(client_time_ns=1)).SerializeToString(),
    ]
    clip = service_pb2.GenerateClipRequest(open=opening, frame_count=8, sample_count=1)
    clip.open.ClearField("lookahead_frames")
    path = f"/{SERVICE_NAME}/GenerateClip"

    async def stream() -> None:
        async with channel_to(address) as channel:
            call = bare_stream(channel)
            begin = Request(events=[Event(session=1, event_seq=1, open=opening)])
            await call.write(HELLO)
            await call.write(begin.SerializeToString())
            reading = asyncio.create_task(drain(call))
            try:
                while True:
                    await call.write(mutated(chance.choice(good), chance))
                    await asyncio.sleep(0.002)
            finally:
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    async def clips() -> None:
        async with channel_to(address) as channel:
            while True:
                await asyncio.sleep(0.05)
                call = channel.unary_stream(path)(mutated(clip.SerializeToString(), chance), timeout=5)
                with contextlib.suppress(grpc.aio.AioRpcError):
                    await drain(call)

    async def others() -> None:
        text = service_pb2.GetCatalogRequest(catalog_etag=SERVICE_NAME).SerializeToString()
        async with channel_to(address) as channel:
            while True:
                await asyncio.sleep(0.05)
                call = channel.unary_stream(chance.choice(OTHERS))(mutated(text, chance), timeout=0.5)
                with contextlib.suppress(grpc.aio.AioRpcError):
                    await drain(call)

    await asyncio.gather(many(STREAMS, stream), many(2, clips), many(2, others))
