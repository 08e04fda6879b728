"""Hostile clients that make the server keep their messages, or its answers; see `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import itertools
from typing import Any

import grpc.aio

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.calls import HELLO, STREAMS, Event, Request, bare_stream, channel_to, drain, for_ever, many


async def unconfirmed_edits(address: str) -> None:
    """Sessions whose constraints all leave their frames to the server, which reports where it has placed them. The
    clients never confirm these answers.
    """
    anywhere = [
        motion_pb2.Constraint(constraint_id=n, at_any_frame=True, waypoint=motion_pb2.Waypoint(x=float(n), z=1.0))
        for n in range(1, 257)
    ]
    edit = session_pb2.EditConstraints(upsert=anywhere)

    async def once() -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(16)]
            await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
            reading = asyncio.create_task(drain(call))
            try:
                for event_seq in itertools.count(2):
                    for handle in range(16):
                        report = session_pb2.Playhead(frame=event_seq)
                        edits = Event(session=handle, event_seq=event_seq, edit_constraints=edit)
                        await call.write(Request(events=[Event(session=handle, playhead=report), edits]))
            finally:
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    await many(STREAMS, once)


async def first_messages(address: str) -> None:
    """A thousand streams, each of which sends one message of the greatest length, all at the same moment."""
    message = Request(events=[Event()] * 450_000).SerializeToString()

    async def connection() -> None:
        async with channel_to(address) as channel:
            calls = [bare_stream(channel) for _ in range(100)]
            await asyncio.gather(*(call.write(HELLO) for call in calls), return_exceptions=True)
            await asyncio.gather(*(call.read() for call in calls), return_exceptions=True)
            await asyncio.gather(*(call.write(message) for call in calls), return_exceptions=True)
            await asyncio.sleep(3600)

    await asyncio.gather(*(for_ever(connection) for _ in range(10)))


_SESSIONS = 64


async def _opened(call: Any) -> dict[int, str]:
    """Open sessions on a new stream, and return their tokens by handle."""
    opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(_SESSIONS)]
    await call.write(Request(hello=service_pb2.ClientHello(client_agent="hostile"), events=opens))
    tokens: dict[int, str] = {}
    while len(tokens) < _SESSIONS:
        response = await call.read()
        if response is grpc.aio.EOF:
            raise ConnectionResetError("the stream ended before all sessions were open")
        tokens |= {each.session: each.opened.session_token for each in response.updates if each.HasField("opened")}
    return tokens


async def unread_resumes(address: str) -> None:
    """Clients that resume their sessions on their own stream again and again, and read none of the frames that are sent
    again.
    """

    async def once() -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            tokens = await _opened(call)
            for attempt in itertools.count(1):
                first = _SESSIONS * attempt  # handles are not used again
                for handle, token in tokens.items():
                    point = session_pb2.ResumePoint(attempt=attempt, answered_seq=1)
                    again = session_pb2.OpenSession(resume_token=token, resume_point=point)
                    await call.write(Request(events=[Event(session=first + handle, event_seq=1, open=again)]))

    await many(4, once)


async def unread_reopenings(address: str) -> None:
    """Clients that close their sessions and open others on the same handles, again and again, and read nothing."""

    async def once() -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            await _opened(call)
            events = [
                event
                for n in range(_SESSIONS)
                for event in (
                    Event(session=n, event_seq=2, close=session_pb2.CloseSession()),
                    Event(session=n, event_seq=1, open=session_pb2.OpenSession()),
                )
            ]
            while True:
                await call.write(Request(events=events))

    await many(4, once)
