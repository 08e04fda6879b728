"""What the service's own code costs per chunk, without gRPC: `python -m tests.bench.service_path [--sizes 1 50]`.

In a single thread, requests are read from bytes, the null engine answers, its outputs go into the streams' queues, and
messages are made of them. The figure for each part is its least CPU time in many rounds, which is its cost without
disturbance, so that figures from a busy machine can be compared. `tests.bench.service_cost` adds gRPC, threads, and
their effects on each other.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
import time
from collections import defaultdict

import grpc.aio

from motiongen.v1 import service_pb2, session_pb2
from motiongen_server.config import parse_config
from motiongen_server.engine.types import Output
from motiongen_server.models.factory import make_limits
from motiongen_server.rpc.budgets.peer import Peer
from motiongen_server.rpc.streams.reader import StreamReader
from motiongen_server.rpc.streams.stream import Stream
from tests.bench.null_load import LOOKAHEAD
from tests.bench.null_process import SETTINGS
from tests.bench.service_cost import CHUNK_FRAMES
from tests.bench.stand_ins import NullEngine, null_models

PARTS = ("reading reports", "null engine", "queueing", "making messages")
SESSIONS = 200


class Said:
    """A stream context with one message to read."""

    def __init__(self, data: bytes) -> None:
        self._data: bytes | object = data

    async def read(self) -> bytes | object:
        data, self._data = self._data, grpc.aio.EOF
        return data


def hello() -> bytes:
    greeting = service_pb2.ClientHello(client_agent="service-path")
    return service_pb2.StreamMotionRequest(hello=greeting).SerializeToString()


def opens(count: int) -> bytes:
    opening = session_pb2.OpenSession(seed=1, lookahead_frames=LOOKAHEAD, denoise_steps=2)
    events = [session_pb2.SessionEvent(session=handle, event_seq=1, open=opening) for handle in range(count)]
    return service_pb2.StreamMotionRequest(events=events).SerializeToString()


def reports(count: int, frame: int) -> bytes:
    """A message in which all sessions of a stream report this frame as their playhead."""
    report = session_pb2.Playhead(frame=frame, buffered_to=frame + LOOKAHEAD - CHUNK_FRAMES)
    events = [session_pb2.SessionEvent(session=handle, playhead=report) for handle in range(count)]
    return service_pb2.StreamMotionRequest(events=events).SerializeToString()


def queue(outputs: list[Output], streams: list[Stream]) -> None:
    by_stream: defaultdict[int, list[Output]] = defaultdict(list)
    for output in outputs:
        by_stream[output.session.stream].append(output)
    for number, said in by_stream.items():
        streams[number].take_all(said)


def make_messages(streams: list[Stream]) -> None:
    for stream in streams:
        while stream.next_response() is not None:
            pass


async def least_us(sessions_a_stream: int, rounds: int, sessions: int = SESSIONS) -> list[float]:
    """CPU microseconds per chunk of each part, in the best of the rounds."""
    engine, num_streams = NullEngine(), max(1, sessions // sessions_a_stream)
    config = parse_config(list(SETTINGS))
    models, peer = null_models(config, engine), Peer(make_limits(config).peer, time.monotonic())
    reader = StreamReader(models, "bench")
    streams = [Stream(number, models, peer=peer) for number in range(num_streams)]

    async def say(data: bytes) -> None:
        for stream in streams:
            await reader.read(stream, Said(data))  # type: ignore[arg-type]

    await say(hello())
    await say(opens(sessions_a_stream))
    queue(engine.answers(), streams)
    make_messages(streams)
    least = [float("inf")] * len(PARTS)
    for number in range(1, rounds + 1):
        request = reports(sessions_a_stream, number * CHUNK_FRAMES)
        times = [time.process_time()]
        await say(request)
        times.append(time.process_time())
        outputs = engine.answers()
        times.append(time.process_time())
        queue(outputs, streams)
        times.append(time.process_time())
        make_messages(streams)
        times.append(time.process_time())
        least = [min(old, after - before) for old, before, after in zip(least, times, times[1:], strict=False)]
    return [1e6 * seconds / (sessions_a_stream * num_streams) for seconds in least]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.service_path", description=__doc__)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 10, 50], help="chunks per message")
    parser.add_argument("--rounds", type=int, default=300)
    parser.add_argument(
        "--sessions", type=int, default=SESSIONS, help="of all streams; with many, the CPU's caches miss (%(default)s)"
    )
    options = parser.parse_args()
    print(f"| chunks a message | us a chunk | {' | '.join(PARTS)} |")
    print("|---:|---:|---:|---:|---:|---:|")
    for size in options.sizes:
        found = asyncio.run(least_us(size, options.rounds, options.sessions))
        print(f"| {size} | {sum(found):.2f} | {' | '.join(f'{each:.2f}' for each in found)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
