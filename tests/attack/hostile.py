"""Hostile clients, each a process of its own at the usual niceness: `python -m tests.attack.hostile KIND ADDRESS SEED`.

They run until they are killed. Messages are serialized beforehand, so that an attack costs them little.
"""

from __future__ import annotations

import asyncio
import itertools
import random
import sys
import time
from collections.abc import Callable

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from tests.attack.calls import HELLO, STREAMS, Event, Request, bare_stream, channel_to, drain, flood, for_ever, many
from tests.attack.heavy_edits import long_paths, many_rotations, refused_rotations
from tests.attack.hostile_calls import half_open_calls, unread_calls, unreadable_names
from tests.attack.hostile_frames import forbidden_frames, needless_frames, resets, tiny_headers
from tests.attack.hostile_load import (
    Kind,
    burst_streams,
    byte_a_second,
    crowds,
    drawn,
    edits_behind_prompts,
    health_checks,
    reflections,
    watches,
    welcome_crowds,
)
from tests.attack.hostile_memory import first_messages, unconfirmed_edits, unread_reopenings, unread_resumes
from tests.attack.hostile_playheads import fast_players, teleporters
from tests.attack.hostile_sockets import connections, garbage, idle_connections, unread_metrics
from tests.attack.hostile_tokens import expired_tokens
from tests.attack.mutation import mutations
from tests.attack.prompts_over_streams import prompts_over_streams


async def empty_events(address: str) -> None:
    await flood(address, [Request(events=[Event()] * 200).SerializeToString()])


async def empty_constraints(address: str) -> None:
    edit = session_pb2.EditConstraints(upsert=[motion_pb2.Constraint()] * 400_000)
    await flood(address, [Request(events=[Event(session=1, event_seq=2, edit_constraints=edit)]).SerializeToString()])


async def many_removals(address: str) -> None:
    """Edits of an open session that each remove 300,000 constraints."""
    edit = session_pb2.EditConstraints(remove=range(1, 300_001))
    events = [Event(session=1, event_seq=number, edit_constraints=edit) for number in range(2, 40)]
    opening = Event(session=1, event_seq=1, open=session_pb2.OpenSession())
    await flood(address, [Request(events=[event]).SerializeToString() for event in (opening, *events)])


async def huge_messages(address: str) -> None:
    await flood(address, [Request(events=[Event()] * 450_000).SerializeToString()], reads=False, streams=40)


async def pings(address: str) -> None:
    await flood(address, [Request(ping=service_pb2.Ping(client_time_ns=1)).SerializeToString()])


async def failing_opens(address: str) -> None:
    """Opens of a rig that does not exist, each with a prompt that is new to the server."""
    numbers = itertools.count()
    name = f"{time.time_ns()}"

    def message() -> bytes:
        events = []
        for handle in range(20):
            spans = [motion_pb2.PromptSpan(prompt_id=1, text=f"a person does {name} {next(numbers)}")]
            opening = session_pb2.OpenSession(rig_id="none", prompts=spans)
            events.append(Event(session=handle, event_seq=1, open=opening))
        return Request(events=events).SerializeToString()

    await flood(address, [message() for _ in range(3_000)])


async def new_prompts(address: str) -> None:
    """One session a stream, with edits of 16 prompts that are new to the server, 50 a second."""
    numbers = itertools.count()
    name = f"{time.time_ns()}"

    async def once() -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opening = Event(session=1, event_seq=1, open=session_pb2.OpenSession())
            await call.write(Request(hello=service_pb2.ClientHello(), events=[opening]))
            reading = asyncio.create_task(drain(call))
            try:
                for event_seq in itertools.count(2):
                    spans = [
                        motion_pb2.PromptSpan(prompt_id=index, text=f"does {name} {next(numbers)}")
                        for index in range(1, 17)
                    ]
                    edit = session_pb2.EditPrompts(upsert=spans)
                    await call.write(Request(events=[Event(session=1, event_seq=event_seq, edit_prompts=edit)]))
                    await asyncio.sleep(0.02)
            finally:
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    await many(STREAMS, once)


async def liars(address: str) -> None:
    """Sessions that report as played all that they were sent: the last frame, the one after it, or frame 2^53."""

    async def once(frame_of: Callable[[int], int]) -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(2)]
            await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
            while isinstance(response := await call.read(), service_pb2.StreamMotionResponse):
                reports = []
                for update in response.updates:
                    if update.HasField("chunk"):
                        end = update.chunk.first_frame + update.chunk.frame_count
                        playhead = session_pb2.Playhead(frame=frame_of(end), buffered_to=end, underruns=2**32 - 1)
                        reports.append(Event(session=update.session, playhead=playhead))
                if reports:
                    await call.write(Request(events=reports))

    kinds: list[Callable[[int], int]] = [lambda end: end - 1, lambda end: end, lambda end: 2**53]
    await asyncio.gather(*(for_ever(lambda kind=kind: once(kind)) for kind in kinds * 2))


async def silent_streams(address: str) -> None:
    """3,000 streams that never send a hello."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            calls = [bare_stream(channel) for _ in range(250)]
            await asyncio.gather(*(call.wait_for_connection() for call in calls), return_exceptions=True)
            await asyncio.sleep(3600)

    await many(12, connection)


async def unread_clips(address: str) -> None:
    """Clips of the maximum length, of which only the first message is read."""

    async def once() -> None:
        async with channel_to(address) as channel:
            asked = service_pb2.GenerateClipRequest(frame_count=2_400, sample_count=16)
            call = service_pb2_grpc.MotionServiceStub(channel).GenerateClip(asked)
            await call.read()
            await asyncio.sleep(3600)

    await many(24, once)


async def unread_streams(address: str) -> None:
    """Events that are refused, on streams that do not read the answers."""
    await flood(address, [Request(events=[Event(session=5)] * 200).SerializeToString()], reads=False, streams=40)


async def catalogs(address: str) -> None:
    async def once() -> None:
        async with channel_to(address) as channel:
            stub = service_pb2_grpc.MotionServiceStub(channel)
            while True:
                await stub.GetCatalog(service_pb2.GetCatalogRequest())

    await many(STREAMS, once)


async def heroes(address: str) -> None:
    """Up to 512 sessions of the class HERO, all of which are edited ten times a second."""
    texts = ("a person walks forward", "a person waves")

    async def once() -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opening = session_pb2.OpenSession(priority=session_pb2.PRIORITY_CLASS_HERO)
            opens = [Event(session=n, event_seq=1, open=opening) for n in range(256)]
            await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
            reading = asyncio.create_task(drain(call))
            try:
                for event_seq in itertools.count(2):
                    span = motion_pb2.PromptSpan(prompt_id=1, text=texts[event_seq % 2])
                    edit = session_pb2.EditPrompts(upsert=[span])
                    edits = [Event(session=n, event_seq=event_seq, edit_prompts=edit) for n in range(256)]
                    await call.write(Request(events=edits))
                    await asyncio.sleep(0.1)
            finally:
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    await many(2, once)


async def playheads(address: str) -> None:
    """Playheads that repeat the same frame, for an open session and for one that does not exist."""
    report = session_pb2.Playhead(frame=1, buffered_to=1)
    opening = Request(events=[Event(session=1, event_seq=1, open=session_pb2.OpenSession())]).SerializeToString()
    reports = [Event(session=1 + number % 2, playhead=report) for number in range(200)]
    await flood(address, [opening, *[Request(events=reports).SerializeToString()] * 1000])


async def empty_streams(address: str) -> None:
    """3,000 streams that send a hello and open no session."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            calls = [bare_stream(channel) for _ in range(250)]
            await asyncio.gather(*(call.write(HELLO) for call in calls), return_exceptions=True)
            await asyncio.sleep(3600)

    await many(12, connection)


async def long_names(address: str) -> None:
    """Names of models and rigs of 5,000 characters, which answers and logs might repeat."""
    opens = [
        Event(session=n, event_seq=1, open=session_pb2.OpenSession(model_id="m" * 5_000, rig_id="r" * 5_000))
        for n in range(20)
    ]
    await flood(address, [Request(events=opens).SerializeToString()])


KINDS: dict[str, Kind] = {
    kind.__name__: kind
    for kind in (
        empty_events, empty_constraints, many_removals, huge_messages, pings, failing_opens, new_prompts, liars,
        silent_streams, unread_clips, unread_streams, catalogs, connections, garbage, heroes, playheads, empty_streams,
        long_names, idle_connections, unread_metrics, mutations, byte_a_second, burst_streams, crowds, watches,
        edits_behind_prompts, health_checks, long_paths, reflections, welcome_crowds, many_rotations, refused_rotations,
        unconfirmed_edits, first_messages, half_open_calls, unread_calls, fast_players, teleporters, expired_tokens,
        prompts_over_streams, unreadable_names, tiny_headers, resets, forbidden_frames, needless_frames,
        unread_resumes, unread_reopenings,
    )
}  # fmt: skip
NOT_DRAWN = {connections, idle_connections, unread_metrics, welcome_crowds, expired_tokens, tiny_headers}
"""Left out of `drawn`: they take all connections, attack the operations port, need a server with tokens, take memory
that the server cannot bound, or are not hostile."""


async def main(name: str, address: str, seed: int) -> None:
    random.seed(seed)
    if name == "drawn":
        await drawn([kind for kind in KINDS.values() if kind not in NOT_DRAWN], address, seed)
    else:
        await KINDS[name](address)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
