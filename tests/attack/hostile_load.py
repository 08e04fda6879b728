"""Hostile clients that keep the protocol: too many, too slow, or reconnecting. See `tests.attack.hostile`."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import socket
import time
from collections.abc import Callable, Coroutine, Sequence
from typing import Any

from grpc_health.v1 import health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection_pb2

from motiongen.v1 import motion_pb2, service_pb2, service_pb2_grpc, session_pb2
from motiongen_server.rpc.handlers import SERVICE_NAME
from tests.attack.calls import HELLO, STREAMS, Event, Request, bare_stream, channel_to, drain, for_ever, many

FPS = 20
FREE_BYTES = 16_384
"""What a slow connection lets through at first: enough for a stream to begin."""
RETRY_S = 0.5
AT_ONCE = 5
Kind = Callable[[str], Coroutine[Any, Any, None]]


async def byte_a_second(address: str) -> None:
    """Streams that play, over connections that let through a byte per second from the server."""
    host, _, port = address.rpartition(":")

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        behind = socket.create_connection((host, int(port)), timeout=1)
        behind.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        from_server, to_server = await asyncio.open_connection(sock=behind, limit=1024)

        async def there() -> None:
            while data := await reader.read(4096):
                to_server.write(data)
                await to_server.drain()

        async def back() -> None:
            passed = 0
            while data := await from_server.read(1024 if passed < FREE_BYTES else 1):
                passed += len(data)
                writer.write(data)
                await asyncio.sleep(0 if passed < FREE_BYTES else 1)

        ways = [asyncio.create_task(there()), asyncio.create_task(back())]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        for end in (writer, to_server):
            end.transport.abort()

    async def once() -> None:
        async with channel_to(f"127.0.0.1:{line.sockets[0].getsockname()[1]}") as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(16)]
            await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
            for tenth in itertools.count():
                report = session_pb2.Playhead(frame=tenth * FPS // 10, buffered_to=tenth * FPS // 10)
                await call.write(Request(events=[Event(session=n, playhead=report) for n in range(16)]))
                await asyncio.sleep(0.1)

    line = await asyncio.start_server(serve, "127.0.0.1", 0)
    async with line:
        await many(STREAMS, once)


async def burst_streams(address: str) -> None:
    """Streams that send a second's worth of events at once, end, and start again."""
    burst = Request(events=[Event()] * 500).SerializeToString()

    async def once() -> None:
        async with channel_to(address) as channel:
            while True:
                call = bare_stream(channel)
                await call.write(HELLO)
                for _ in range(10):
                    await call.write(burst)
                call.cancel()

    await many(STREAMS, once)


async def edits_behind_prompts(address: str) -> None:
    """Sessions whose long edits each wait behind a prompt that is new to the server."""
    far = motion_pb2.RootTrajectory(positions=[1.0] * 800)
    paths = [motion_pb2.Constraint(constraint_id=n, frame=40, root_trajectory=far) for n in range(1, 20)]  # 61 kB
    name = random.getrandbits(64)

    async def once(stream: int) -> None:
        async with channel_to(address) as channel:
            call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
            opens = [Event(session=n, event_seq=1, open=session_pb2.OpenSession()) for n in range(64)]
            await call.write(Request(hello=service_pb2.ClientHello(), events=opens))
            reading = asyncio.create_task(drain(call))
            try:
                for number in itertools.count(2):
                    for handle in range(64):
                        event = Event(session=handle, event_seq=number)
                        if number % 20 == 2:
                            text = f"does {name} {stream} {handle} {number}"
                            event.edit_prompts.upsert.add(prompt_id=1, text=text)
                        else:
                            event.edit_constraints.upsert.extend(paths)
                        await call.write(Request(events=[event]))
            finally:
                reading.cancel()
                await asyncio.gather(reading, return_exceptions=True)

    await asyncio.gather(*(for_ever(lambda stream=stream: once(stream)) for stream in range(STREAMS)))


async def watches(address: str) -> None:
    """Health watches, more than there are places for all calls."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            stub: Any = health_pb2_grpc.HealthStub(channel)  # its stubs name no methods
            calls = [stub.Watch(health_pb2.HealthCheckRequest()) for _ in range(250)]
            await asyncio.gather(*(call.read() for call in calls), return_exceptions=True)
            await asyncio.sleep(RETRY_S)

    await many(16, connection)


async def health_checks(address: str) -> None:
    """Health checks without end, 32 at a time on each of some connections."""

    async def connection() -> None:
        async with channel_to(address) as channel:
            stub: Any = health_pb2_grpc.HealthStub(channel)  # its stubs name no methods
            await many(32, lambda: stub.Check(health_pb2.HealthCheckRequest()))

    await many(STREAMS, connection)


async def reflections(address: str) -> None:
    """Reflection requests without end."""
    question = reflection_pb2.ServerReflectionRequest(file_containing_symbol=SERVICE_NAME).SerializeToString()

    async def once() -> None:
        async with channel_to(address) as channel:
            call = channel.stream_stream("/grpc.reflection.v1.ServerReflection/ServerReflectionInfo")()
            while True:
                await call.write(question)

    await many(64, once)


class Crowd:
    """A stream of sessions that play in real time. A session that is refused is requested again."""

    def __init__(self, call: Any, num_sessions: int) -> None:
        self._call = call
        self._begun_s: dict[int, float] = {}
        self._sent_to: dict[int, int] = {}
        self._refused = set(range(num_sessions))

    async def play(self) -> None:
        """Play until the stream ends."""
        await self._call.write(Request(hello=service_pb2.ClientHello()))
        reading = asyncio.create_task(self._read())
        opening = session_pb2.OpenSession(priority=session_pb2.PRIORITY_CLASS_CROWD)
        try:
            for tick in itertools.count():
                now = time.perf_counter()
                opens = []
                if tick % round(RETRY_S / 0.25) == 0:
                    opens = [Event(session=n, event_seq=1, open=opening) for n in self._refused]
                    self._refused.clear()
                reports = [Event(session=n, playhead=self._playhead(n, now)) for n in self._begun_s]
                await self._call.write(Request(events=opens + reports))
                await asyncio.sleep(0.25)
        finally:
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)

    def _playhead(self, handle: int, now: float) -> session_pb2.Playhead:
        end = self._sent_to[handle]
        frame = min(int((now - self._begun_s[handle]) * FPS), max(0, end - 1))
        return session_pb2.Playhead(frame=frame, buffered_to=end)

    async def _read(self) -> None:
        while isinstance(response := await self._call.read(), service_pb2.StreamMotionResponse):
            for update in response.updates:
                handle, kind = update.session, update.WhichOneof("update")
                if kind == "chunk":
                    self._sent_to[handle] = update.chunk.first_frame + update.chunk.frame_count
                    self._begun_s.setdefault(handle, time.perf_counter())
                elif kind == "closed" or (kind == "outcome" and update.outcome.event_seq == 1 and update.outcome.code):
                    self._begun_s.pop(handle, None)
                    self._refused.add(handle)


async def crowds(address: str, of_each_stream: int = 64) -> None:
    """512 sessions of the class CROWD, each of which retries until it is admitted, and then plays."""

    async def once() -> None:
        async with channel_to(address) as channel:
            await Crowd(service_pb2_grpc.MotionServiceStub(channel).StreamMotion(), of_each_stream).play()

    await many(STREAMS, once)


async def welcome_crowds(address: str) -> None:
    """200 such sessions, about as many as are admitted."""
    await crowds(address, 25)


async def drawn(kinds: Sequence[Kind], address: str, seed: int) -> None:
    """Five attacks at a time, each of a kind and length drawn from the seed."""

    async def one_after_the_other(number: int) -> None:
        chance = random.Random(f"{seed}-{number}")
        while True:
            kind, seconds = chance.choice(kinds), chance.uniform(0.5, 2.0)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    await kind(address)

    await asyncio.gather(*(one_after_the_other(number) for number in range(AT_ONCE)))
