"""Hostile clients whose token expires while they use it, and that keep using it; see `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import contextlib
import itertools

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.calls import STREAMS, Event, Request, channel_to, drain, many

SESSIONS = 8
TEXTS = ("a person walks forward", "a person waves")


async def expired_tokens(address: str) -> None:
    """Streams with sessions that are edited all the time, and clips, restarted at once whenever they are ended."""

    async def stream() -> None:
        async with channel_to(address) as channel:
            while True:
                call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
                opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(SESSIONS)]
                reading = asyncio.create_task(drain(call))
                with contextlib.suppress(grpc.aio.AioRpcError, asyncio.InvalidStateError):
                    await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
                    for number in itertools.count(2):
                        span = motion_pb2.PromptSpan(prompt_id=1, text=TEXTS[number % 2])
                        edit = session_pb2.EditPrompts(upsert=[span])
                        events = [Event(session=n, event_seq=number, edit_prompts=edit) for n in range(SESSIONS)]
                        await call.write(Request(events=events))
                        await asyncio.sleep(0.02)
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    async def clip() -> None:
        async with channel_to(address) as channel:
            stub = service_pb2_grpc.MotionServiceStub(channel)
            while True:
                with contextlib.suppress(grpc.aio.AioRpcError):
                    await drain(stub.GenerateClip(service_pb2.GenerateClipRequest(frame_count=40)))

    await asyncio.gather(many(STREAMS, stream), many(STREAMS, clip))
