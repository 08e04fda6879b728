"""Whether a quiet stream survives a client's keepalive every second: `python -m tests.attack.keepalives`."""

from __future__ import annotations

import asyncio
import sys
import tempfile
from pathlib import Path

import grpc.aio

from motiongen.v1 import service_pb2, service_pb2_grpc
from tests.attack.server import attacked

OPTIONS = (
    ("grpc.keepalive_time_ms", 1_100), ("grpc.keepalive_timeout_ms", 5_000),
    ("grpc.keepalive_permit_without_calls", 1), ("grpc.http2.max_pings_without_data", 0),
)  # fmt: skip


async def outcome(address: str, seconds: float) -> str:
    """Whether a quiet stream survives for so many seconds, in words."""
    async with grpc.aio.insecure_channel(address, options=OPTIONS) as channel:
        call = service_pb2_grpc.MotionServiceStub(channel).StreamMotion()
        await call.write(service_pb2.StreamMotionRequest(hello=service_pb2.ClientHello()))
        await call.read()
        reading = asyncio.create_task(call.read())  # type: ignore[arg-type]
        await asyncio.wait({reading}, timeout=seconds)
        lives = not reading.done()
        call.cancel()
        await asyncio.gather(reading, return_exceptions=True)
        return "it lives" if lives else f"it ended: {await call.details()}"


async def main(seconds: float = 12.0) -> int:
    with tempfile.TemporaryDirectory() as folder, attacked(Path(folder) / "log") as server:
        told = await outcome(server.address, seconds)
    print(f"a stream with a keepalive every {OPTIONS[0][1] / 1000:g} s, after {seconds:g} s: {told}")
    return 0 if told == "it lives" else 1


if __name__ == "__main__":
    sys.exit(asyncio.run(main()))
